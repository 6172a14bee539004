// The page of a dataset or a folder of flows: panels of one pair side by side, with the values under the pointer.

class PairsPage {
  constructor(pack, root) {
    Object.assign(this, { pack, index: 0, shown: new Set(), zoom: 1, pan: [0, 0], full: 0, errorFull: 0, packs: new Map() });
    this.panels = element("div", { class: "panels" });
    this.chips = element("div", { class: "choice chips", role: "group", "aria-label": "panels" });
    this.name = element("p", { class: "about" });
    this.scores = element("div", { class: "scores" });
    const last = pack.pairs.length - 1;
    this.slider = slider("Pair", { max: last, step: 1, digits: 0, onchange: (index) => this.go(index) });
    this.playButton = element("button", { type: "button", class: "play", onclick: () => this.play() }, "Play");
    const controls = element("aside", { class: "controls" },
      element("h1", {}, pack.title), element("p", { class: "about" }, pack.about),
      ...(last > 0 ? [element("div", { class: "timeline" }, this.playButton, this.slider)] : []),
      this.name, this.chips,
      slider("Full colour at, px (0: longest)", { max: 50, step: 0.1, digits: 1, onchange: (full) => this.look({ full }) }),
      slider("Full error at, px (0: 99 % of the pixels)", { max: 10, step: 0.05, digits: 2, onchange: (errorFull) => this.look({ errorFull }) }),
      element("button", { type: "button", onclick: () => this.look({ zoom: 1, pan: [0, 0] }) }, "Whole frame"),
      this.scores, this.help());
    root.append(element("div", { class: "stage" }, this.panels), controls);
    document.addEventListener("keydown", (event) => isForPage(event) && this.key(event));
    new ResizeObserver(() => this.draw()).observe(this.panels);
    const hash = new URLSearchParams(location.hash.slice(1));
    const index = Number(hash.get("pair"));
    this.wanted = hash.get("panels")?.split(",");
    this.go(Number.isInteger(index) && index >= 0 && index <= last ? index : 0);
  }

  help() {
    const keys = [["← →", "pair"], ["space", "play"], ["1 to 9", "panels"], ["wheel", "zoom"], ["drag", "move"], ["R", "whole frame"], ["B", "hold: frame 2 in place of frame 1"]];
    const items = keys.flatMap(([key, does]) => [element("dt", {}, element("kbd", {}, key)), element("dd", {}, does)]);
    return element("details", {}, element("summary", {}, "Keys"), element("dl", { class: "keys" }, ...items));
  }

  /** Shows a pair; the last one asked for wins. `settled` is kept until it is there. */
  go(index) {
    this.index = index;
    this.slider.set(index);
    const settled = this.load(index).then((pair) => {
      if (this.index !== index) return;
      this.pair = pair;
      this.name.textContent = this.pack.pairs[index];
      this.list();
      this.draw();
      remember({ pair: index, panels: [...this.shown].join(",") });
      if (index + 1 < this.pack.pairs.length) this.load(index + 1);
    });
    this.settled = settled
      .catch((error) => (this.name.textContent = `${this.pack.pairs[index]}: ${error.message}`))
      .finally(() => this.index === index && (this.settled = null));
    return this.settled;
  }

  load(index) {
    if (!this.packs.has(index)) {
      this.packs.set(index, loadPack(index).then((pack) => Pair.of(pack)));
      const oldest = [...this.packs.keys()].find((other) => Math.abs(other - index) > 4);
      if (oldest !== undefined) this.packs.delete(oldest);
    }
    return this.packs.get(index);
  }

  play() {
    this.playing = !this.playing;
    this.playButton.textContent = this.playing ? "Pause" : "Play";
    let waited = 0;
    animate(async (seconds) => {
      waited += seconds;
      if (this.playing && waited > 0.2) {
        waited = 0;
        await this.go((this.index + 1) % this.pack.pairs.length);
      }
      return this.playing;
    });
  }

  key(event) {
    if (event.target.matches?.("input[type=range]") && event.key.startsWith("Arrow")) return;
    const last = this.pack.pairs.length - 1;
    const actions = {
      ArrowLeft: () => this.go(Math.max(this.index - 1, 0)),
      ArrowRight: () => this.go(Math.min(this.index + 1, last)),
      " ": () => last > 0 && this.play(),
      r: () => this.look({ zoom: 1, pan: [0, 0] }),
      b: () => this.look({ swapped: true }),
    };
    [...this.chips.children].slice(0, 9).forEach((chip, i) => (actions[i + 1] = () => chip.click()));
    const action = actions[event.key] ?? actions[event.key.toLowerCase()];
    if (!action) return;
    if (event.key === " ") event.preventDefault();
    if (event.key.toLowerCase() === "b") document.addEventListener("keyup", () => this.look({ swapped: false }), { once: true });
    action();
  }

  look(change) {
    Object.assign(this, change);
    this.draw();
  }

  /** Chips of the layers of this pair; the choice is kept from pair to pair. */
  list() {
    const layers = this.pair.layers();
    if (!this.shown.size) {
      const wanted = layers.filter((layer) => this.wanted?.includes(layer.key));
      const usual = layers.filter((layer) => ["frame1", "flow"].includes(layer.key) || layer.kind === "flow");
      for (const layer of wanted.length ? wanted : usual.slice(0, 4)) this.shown.add(layer.key);
    }
    this.chips.replaceChildren(...layers.map((layer) => {
      const toggle = () => {
        if (!this.shown.delete(layer.key)) this.shown.add(layer.key);
        chip.setAttribute("aria-pressed", this.shown.has(layer.key));
        this.draw();
      };
      const chip = element("button", { type: "button", "data-key": layer.key, "aria-pressed": this.shown.has(layer.key), onclick: toggle }, layer.title);
      return chip;
    }));
    this.scores.replaceChildren(...this.pair.scoreTable());
  }

  draw() {
    if (!this.pair) return;
    const layers = this.pair.layers().filter((layer) => this.shown.has(layer.key));
    while (this.panels.children.length > layers.length) this.panels.lastChild.remove();
    while (this.panels.children.length < layers.length) this.panels.append(this.newPanel());
    const { width, height } = this.pair;
    const box = this.panels.getBoundingClientRect();
    const columns = bestColumns(layers.length, box.width / box.height, width / height);
    this.panels.style.gridTemplateColumns = `repeat(${columns}, 1fr)`;
    layers.forEach((layer, i) => this.drawPanel(this.panels.children[i], layer));
    this.writeValues();
  }

  newPanel() {
    const canvas = element("canvas", {});
    const panel = element("figure", {}, element("figcaption", {}, element("b"), element("span")), canvas);
    canvas.onpointermove = (event) => {
      if (event.buttons) {
        this.pan = [this.pan[0] + event.movementX, this.pan[1] + event.movementY];
        this.draw();
      }
      const at = this.placeOf(canvas, event.clientX, event.clientY);
      this.pointer = at.map(Math.floor);
      this.writeValues();
    };
    canvas.onpointerleave = () => {
      this.pointer = null;
      this.writeValues();
    };
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const box = canvas.getBoundingClientRect();
      const zoom = Math.min(Math.max(this.zoom * Math.exp(-event.deltaY / 400), 1), 64);
      const pointer = [event.clientX - box.left, event.clientY - box.top];
      this.pan = this.pan.map((pan, i) => pointer[i] - ((pointer[i] - pan) * zoom) / this.zoom);
      if (zoom === 1) this.pan = [0, 0];
      this.look({ zoom });
    }, { passive: false });
    return panel;
  }

  /** CSS pixels per pixel of the frame, and the place of its corner. */
  scaleOf(canvas) {
    const box = canvas.getBoundingClientRect();
    const fit = Math.min(box.width / this.pair.width, box.height / this.pair.height);
    const corner = [(box.width - fit * this.pair.width) / 2, (box.height - fit * this.pair.height) / 2];
    return { scale: fit * this.zoom, corner: corner.map((x, i) => x * this.zoom + this.pan[i]), box };
  }

  placeOf(canvas, x, y) {
    const { scale, corner, box } = this.scaleOf(canvas);
    return [(x - box.left - corner[0]) / scale, (y - box.top - corner[1]) / scale];
  }

  drawPanel(panel, layer) {
    const canvas = panel.querySelector("canvas");
    const { scale, corner, box } = this.scaleOf(canvas);
    const ratio = window.devicePixelRatio || 1;
    [canvas.width, canvas.height] = [Math.max(1, Math.round(box.width * ratio)), Math.max(1, Math.round(box.height * ratio))];
    const shown = this.swapped && layer.key === "frame1" ? this.pair.layers().find((other) => other.key === "frame2") ?? layer : layer;
    panel.layer = shown;
    panel.querySelector("b").textContent = shown.title;
    const context = canvas.getContext("2d");
    context.imageSmoothingEnabled = scale * ratio < 1;
    context.imageSmoothingQuality = "high";
    context.setTransform(scale * ratio, 0, 0, scale * ratio, corner[0] * ratio, corner[1] * ratio);
    context.drawImage(this.pair.picture(shown, this.full, this.errorFull), 0, 0);
  }

  writeValues() {
    for (const panel of this.panels.children) {
      const [x, y] = this.pointer ?? [-1, -1];
      const inside = x >= 0 && y >= 0 && x < this.pair.width && y < this.pair.height;
      panel.querySelector("span").textContent = inside ? `${x}, ${y}: ${this.pair.value(panel.layer, x, y)}` : "";
    }
  }
}

/** Number of columns that makes panels of this aspect largest. */
function bestColumns(count, aspect, panelAspect) {
  let best = [0, 1];
  for (let columns = 1; columns <= count; columns++) {
    const rows = Math.ceil(count / columns);
    const width = Math.min(1 / columns, panelAspect / (rows * aspect));
    if (width > best[0]) best = [width, columns];
  }
  return best[1];
}

/** One pair of frames with all that is known of it. */
class Pair {
  static async of(pack) {
    const pair = new Pair();
    const { arrays, width, height } = pack;
    Object.assign(pair, { width, height, methods: pack.methods, planes: {}, pictures: new Map(), frames: {} });
    for (const [name, array] of Object.entries(arrays)) {
      if (name.startsWith("frame")) {
        const bitmap = await createImageBitmap(new Blob([array], { type: "image/png" }));
        const canvas = new OffscreenCanvas(width, height);
        canvas.getContext("2d", { willReadFrequently: true }).drawImage(bitmap, 0, 0);
        pair.frames[name] = canvas;
      } else {
        pair.planes[name] = array instanceof Uint16Array ? singles(array) : array;
      }
    }
    return pair;
  }

  layers() {
    const all = [
      { key: "frame1", title: "Frame 1", kind: "frame" }, { key: "frame2", title: "Frame 2", kind: "frame" },
      { key: "flow", title: this.methods.length ? "True flow" : "Flow", kind: "flow" },
      ...this.methods.map(({ key, name }) => ({ key, title: name, kind: "flow" })),
      ...this.methods.map(({ key, name }) => ({ key: `${key}-error`, title: `Error of ${name}`, kind: "error", of: key })),
      { key: "mask", title: "Head", kind: "mask" }, { key: "occlusion", title: "Occlusion", kind: "mask" },
      { key: "depth", title: "Depth", kind: "depth" },
    ];
    return all.filter(({ key, kind, of }) => this.frames[key] || this.planes[key] || (kind === "error" && this.planes.flow && this.planes[of]));
  }

  scoreTable() {
    if (!this.methods.some((method) => method.epe !== null)) return [];
    const cells = (values, tag) => element("tr", {}, ...values.map((value) => element(tag, {}, value)));
    const number = (value) => (value === null ? "" : value.toFixed(3));
    const rows = this.methods.map(({ name, epe, epe_head }) => cells([name, number(epe), number(epe_head)], "td"));
    return [element("table", {}, cells(["This pair's EPE, px", "all", "head"], "th"), ...rows)];
  }

  error(key, i) {
    const { flow } = this.planes;
    return Math.hypot(this.planes[key][2 * i] - flow[2 * i], this.planes[key][2 * i + 1] - flow[2 * i + 1]);
  }

  /** The longest known flow of the truth, or of all where there is none. */
  longest() {
    this.longestFlow ??= (() => {
      const planes = this.planes.flow ? [this.planes.flow] : this.methods.map(({ key }) => this.planes[key]);
      let longest = 0;
      for (const plane of planes) {
        for (let i = 0; i < plane.length; i += 2) {
          const length = Math.hypot(plane[i], plane[i + 1]);
          if (length > longest && Number.isFinite(length)) longest = length;
        }
      }
      return longest || 1;
    })();
    return this.longestFlow;
  }

  /** The error that 99 % of the pixels of all methods are below. */
  largeError() {
    this.largeErrorFound ??= (() => {
      const errors = this.methods.flatMap(({ key }) => {
        const step = Math.max(1, Math.floor((this.width * this.height) / 20000));
        return Array.from({ length: Math.floor((this.width * this.height) / step) }, (_, i) => this.error(key, i * step));
      }).filter(Number.isFinite).sort((a, b) => a - b);
      return errors[Math.floor(0.99 * errors.length)] || 1;
    })();
    return this.largeErrorFound;
  }

  /** The layer as a canvas, kept until the scales change. */
  picture(layer, full, errorFull) {
    if (layer.kind === "frame") return this.frames[layer.key];
    const scale = layer.kind === "error" ? errorFull || this.largeError() : full || this.longest();
    const name = `${layer.key} ${scale}`;
    if (!this.pictures.has(name)) this.pictures.set(name, this.painted(layer, scale));
    return this.pictures.get(name);
  }

  painted(layer, scale) {
    const picture = new ImageData(this.width, this.height);
    const plane = this.planes[layer.of ?? layer.key];
    let [nearest, farthest] = [Infinity, 0];
    if (layer.kind === "depth") {
      for (const depth of plane) {
        if (depth > 0) [nearest, farthest] = [Math.min(nearest, depth), Math.max(farthest, depth)];
      }
    }
    const colors = {
      flow: (i) => flowColor(plane[2 * i] / scale, plane[2 * i + 1] / scale),
      error: (i) => heatColor(this.error(layer.of, i) / scale),
      mask: (i) => (plane[i] ? [255, 255, 255] : [0, 0, 0]),
      depth: (i) => (plane[i] > 0 ? new Array(3).fill(255 - (215 * (plane[i] - nearest)) / Math.max(farthest - nearest, 1e-6)) : [0, 0, 0]),
    };
    const color = colors[layer.kind];
    for (let i = 0; i < this.width * this.height; i++) {
      const [r, g, b] = color(i);
      picture.data.set([r, g, b, 255], 4 * i);
    }
    const canvas = new OffscreenCanvas(this.width, this.height);
    canvas.getContext("2d").putImageData(picture, 0, 0);
    return canvas;
  }

  /** The value of a layer at a pixel, in words. */
  value(layer, x, y) {
    const i = y * this.width + x;
    const plane = this.planes[layer.of ?? layer.key];
    const signed = (number) => `${number < 0 ? "−" : "+"}${Math.abs(number).toFixed(2)}`;
    const values = {
      frame: () => [...this.frames[layer.key].getContext("2d").getImageData(x, y, 1, 1).data].slice(0, 3).join(" "),
      flow: () => {
        const [u, v] = [plane[2 * i], plane[2 * i + 1]];
        return Number.isNaN(u) ? "unknown" : `${signed(u)}, ${signed(v)} px (${Math.hypot(u, v).toFixed(2)})`;
      },
      error: () => (Number.isNaN(this.error(layer.of, i)) ? "unknown" : `${this.error(layer.of, i).toFixed(3)} px`),
      mask: () => (plane[i] ? "yes" : "no"),
      depth: () => (plane[i] > 0 ? `${plane[i].toFixed(3)} m` : "none"),
    };
    return values[layer.kind]();
  }
}
