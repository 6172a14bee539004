const PAGES = { splats: SplatPage, pairs: PairsPage };

(async () => {
  const root = document.getElementById("view");
  try {
    const pack = await loadPack("main");
    document.title = `${pack.title} · srflow`;
    window.page = new PAGES[pack.page](pack, root);
  } catch (error) {
    root.replaceChildren(element("p", { class: "failed" }, `This page cannot be shown: ${error.message}`));
    throw error;
  }
})();
