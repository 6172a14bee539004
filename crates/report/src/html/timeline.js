for (const figure of document.querySelectorAll("figure.timeline:not([data-ready])")) {
  figure.dataset.ready = "";
  const [seconds, left, right, width] = ["seconds", "left", "right", "width"].map((name) => Number(figure.dataset[name]));
  const video = figure.querySelector("video");
  const picture = figure.querySelector("img");
  const drawing = figure.querySelector("svg");
  const playhead = figure.querySelector(".playhead");
  const show = (time) => {
    const x = left + Math.min(Math.max(time / seconds, 0), 1) * (width - left - right);
    playhead.setAttribute("x1", x);
    playhead.setAttribute("x2", x);
  };
  let seek;
  if (video) {
    seek = (time) => { video.currentTime = time; show(time); };
    const follow = () => { show(video.currentTime); requestAnimationFrame(follow); };
    follow();
  } else {
    const files = picture.dataset.files.split("\n");
    const rate = Number(picture.dataset.rate);
    const [button, clock] = [figure.querySelector("button"), figure.querySelector("output")];
    let [frame, started] = [0, null];
    const draw = (next) => {
      frame = Math.min(Math.max(next, 0), files.length - 1);
      picture.src = picture.dataset.folder + files[frame];
      clock.textContent = (frame / rate).toFixed(2) + " s";
      show(frame / rate);
    };
    const play = (now) => {
      if (started === null) return;
      draw(Math.floor(((now - started) / 1000) * rate));
      if (frame === files.length - 1) { started = null; button.textContent = "Play"; } else requestAnimationFrame(play);
    };
    button.onclick = () => {
      const begin = started === null;
      started = begin ? performance.now() - (frame === files.length - 1 ? 0 : (frame / rate) * 1000) : null;
      button.textContent = begin ? "Pause" : "Play";
      if (begin) requestAnimationFrame(play);
    };
    seek = (time) => {
      if (started !== null) started = performance.now() - time * 1000;
      draw(Math.round(time * rate));
    };
  }
  drawing.onclick = (event) => {
    const box = drawing.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * width;
    seek(Math.min(Math.max((x - left) / (width - left - right), 0), 1) * seconds);
  };
  for (const jump of figure.querySelectorAll(".jumps button")) {
    jump.onclick = () => seek(Number(jump.dataset.seconds));
  }
}
