// The page of a file of Gaussians or of an avatar.

class SplatPage {
  constructor(pack, root) {
    this.pack = pack;
    const { arrays } = pack;
    this.head = pack.head ? new Head(pack.head, arrays) : null;
    this.shading = pack.head?.shading ? new Shading(pack.head.shading, arrays, this.head) : null;
    this.triangles = this.head ? arrays.triangles.length / 3 : 1;
    this.now = new Float32Array(8 * this.triangles);
    this.next = new Float32Array(8 * this.triangles);
    this.camera = new OrbitCamera(pack.surroundings, Boolean(pack.upside_down));
    this.state = {
      layer: "color", to: "next", arrows: false, t: 0, playing: false, full: 0, background: "#14161a",
      units: this.head ? new Array(this.head.units.length).fill(0) : [],
      gaze: [0, 0], turn: [0, 0, 0],
    };
    this.canvas = element("canvas", { tabindex: 0, "aria-label": "the picture; drag to turn, wheel to zoom" });
    this.readout = element("p", { class: "readout", "aria-live": "off" });
    this.rate = element("span", { class: "rate" });
    this.splats = new SplatCanvas(this.canvas, pack, arrays, this.triangles);
    this.stage = element("div", { class: "stage" }, this.canvas, this.readout);
    root.append(this.stage, element("aside", { class: "controls" }, ...this.controls()));
    this.listen();
    this.readHash();
    new ResizeObserver(() => this.changed()).observe(this.stage);
    this.changed();
  }

  controls() {
    const { head, state, pack } = this;
    const layers = head ? ["color", "flow", "depth", "alpha"] : ["color", "depth", "alpha"];
    const words = { color: "Colour", flow: "Flow", depth: "Depth", alpha: "Alpha" };
    this.layerChoice = choice("layer", layers.map((layer) => [layer, words[layer]]), state.layer, (layer) => this.set({ layer }));
    const about = element("p", { class: "about" }, `${pack.arrays.triangle_of.length.toLocaleString("en")} Gaussians `, this.rate);
    const parts = [element("h1", {}, pack.title), about, this.layerChoice];
    if (head) parts.push(...this.motionControls(), ...this.poseControls());
    parts.push(this.viewControls(), this.help());
    return parts;
  }

  motionControls() {
    const { head, state } = this;
    const parts = [];
    this.toChoice = choice("flow to", [["next", "to the next frame"], ["rest", "to rest"]], state.to, (to) => this.set({ to }));
    this.arrowCheck = checkbox("Arrows", state.arrows, (arrows) => this.set({ arrows }));
    this.fullSlider = slider("Full colour at, px (0: longest)", { max: 20, step: 0.1, digits: 1, onchange: (full) => this.set({ full }) });
    if (head.timesteps > 1) {
      this.playButton = element("button", { type: "button", class: "play", onclick: () => this.play() }, "Play");
      this.timeline = slider("Frame", { max: head.timesteps - 1, step: 1, digits: 0, onchange: (t) => this.set({ t, playing: false }) });
      parts.push(element("div", { class: "timeline" }, this.playButton, this.timeline));
    }
    parts.push(element("div", { class: "row" }, this.toChoice, this.arrowCheck), this.fullSlider);
    return parts;
  }

  poseControls() {
    const { head, state } = this;
    const parts = [];
    const angle = (name, list, index, reach) =>
      slider(name, { min: -reach, max: reach, step: 0.01, digits: 2, onchange: (value) => this.setIn(list, index, value) });
    this.poseSliders = [];
    const group = (title, open, sliders) => {
      this.poseSliders.push(...sliders);
      parts.push(element("details", { open }, element("summary", {}, title), ...sliders.map((x) => x.slider)));
    };
    const units = head.units.map((unit, number) => ({
      list: "units", index: number,
      slider: slider(unit.name, { onchange: (value) => this.setIn("units", number, value) }),
    }));
    if (units.length) group("Action units", true, units);
    const turns = [["gaze", 0, "Gaze to the left, rad", 0.6], ["gaze", 1, "Gaze up, rad", 0.5]];
    const eyes = head.hasJoint("left_eye") || head.hasJoint("right_eye");
    const head_ = [["turn", 0, "Turn to the left, rad", 0.8], ["turn", 1, "Nod up, rad", 0.6], ["turn", 2, "Tilt, rad", 0.5]];
    const ofTurn = ([list, index, name, reach]) => ({ list, index, slider: angle(name, list, index, reach) });
    group("Gaze and head", false, [...(eyes ? turns : []), ...head_].map(ofTurn));
    parts.push(element("button", { type: "button", onclick: () => this.relax() }, "Back to rest"));
    return parts;
  }

  viewControls() {
    const background = element("input", { type: "color", value: this.state.background, oninput: () => this.set({ background: background.value }) });
    return element("div", { class: "row" },
      element("button", { type: "button", onclick: () => this.resetView() }, "Reset view"),
      element("label", { class: "check" }, "Background", background));
  }

  help() {
    const keys = [
      ["drag", "turn"], ["shift + drag", "move"], ["wheel", "zoom"], ["1 to 4", "layer"], ["R", "reset view"], ["F", "upside down"],
      ...(this.head ? [["space", "play"], ["← →", "frame"], ["A", "arrows"]] : []),
    ];
    const items = keys.flatMap(([key, does]) => [element("dt", {}, element("kbd", {}, key)), element("dd", {}, does)]);
    return element("details", {}, element("summary", {}, "Keys"), element("dl", { class: "keys" }, ...items));
  }

  set(change) {
    Object.assign(this.state, change);
    this.show();
    this.changed();
  }

  setIn(list, index, value) {
    this.state[list][index] = value;
    this.changed();
  }

  /** Puts the state into the controls. */
  show() {
    const { state } = this;
    this.layerChoice.set(state.layer);
    this.toChoice?.set(state.to);
    this.arrowCheck?.set(state.arrows);
    this.timeline?.set(state.t);
    this.fullSlider?.set(state.full);
    if (this.playButton) this.playButton.textContent = state.playing ? "Pause" : "Play";
    this.poseSliders?.forEach(({ list, index, slider }) => slider.set(state[list][index]));
  }

  relax() {
    const { state } = this;
    this.set({ units: state.units.map(() => 0), gaze: [0, 0], turn: [0, 0, 0], t: 0, playing: false });
  }

  resetView() {
    this.camera.reset();
    this.changed();
  }

  play() {
    if (!this.head || this.head.timesteps < 2) return;
    this.set({ playing: !this.state.playing });
    if (!this.state.playing) return;
    let time = this.state.t / this.head.frames_per_second;
    animate(async (seconds) => {
      if (!this.state.playing) return false;
      time += Math.min(seconds, 0.25);
      this.state.t = Math.floor(time * this.head.frames_per_second) % (this.head.timesteps - 1);
      this.timeline.set(this.state.t);
      this.changed();
      await this.settled;
      return true;
    });
  }

  poseAt(t) {
    const { head, state } = this;
    let pose = head.withUnits(head.timesteps > 0 ? head.poseAt(t) : head.restPose(), state.units);
    const neck = head.hasJoint("neck") ? "neck" : "root";
    pose = head.withTurn(pose, neck, turned(...state.turn));
    for (const eye of ["left_eye", "right_eye"]) pose = head.withTurn(pose, eye, turned(...state.gaze, 0));
    return pose;
  }

  /** Writes the frames of the triangles; returns the length of the longest flow of a vertex in pixels. */
  move(camera) {
    const { head, state } = this;
    if (!head) {
      for (const frames of [this.now, this.next]) frames.set([0, 0, 0, 1, 0, 0, 0, 1]);
      return 1;
    }
    this.pose = this.poseAt(state.t);
    head.pose(this.pose, this.now);
    this.before = head.vertices.slice();
    const later = Math.min(state.t + 1, Math.max(head.timesteps - 1, 0));
    head.pose(state.to === "rest" ? head.restPose() : this.poseAt(later), this.next);
    return longestFlow(this.before, head.vertices, camera);
  }

  /** Draws as soon as what is being drawn is done. `settled` is kept when the picture shows the state. */
  changed() {
    this.stale = true;
    this.settled ??= this.drawAll().finally(() => (this.settled = null));
  }

  async drawAll() {
    while (this.stale) {
      this.stale = false;
      const began = performance.now();
      await this.drawOnce();
      await new Promise((resolve) => requestAnimationFrame(resolve));
      this.rate.textContent = `${Math.round(1000 / (performance.now() - began))} pictures/s`;
    }
    this.writeHash();
  }

  async drawOnce() {
    const camera = this.camera.at(...this.size());
    const moving = this.move(camera);
    this.splats.setFrames(this.now, this.next);
    const order = this.splats.sort(this.now, camera);
    this.shade();
    this.splats.setOrder(await order);
    const { state } = this;
    const longest = state.full > 0 ? state.full : moving;
    const near = this.camera.distance - this.pack.surroundings.radius;
    this.splats.draw(camera, {
      layer: state.layer, longest, arrows: state.arrows, stretch: Math.max(1, 16 / Math.max(longest, 1e-3)),
      background: [1, 3, 5].map((at) => parseInt(state.background.slice(at, at + 2), 16) / 255),
      depths: [Math.max(near, NEAR), this.camera.distance + this.pack.surroundings.radius],
    });
    if (this.pointer) this.read(...this.pointer);
  }

  /** Sets the light on the Gaussians, where the pose is another than before. */
  shade() {
    const { t, units, gaze, turn } = this.state;
    const pose = JSON.stringify([t, units, gaze, turn]);
    if (!this.shading || pose === this.shadedPose) return;
    this.shadedPose = pose;
    this.splats.setFactors(this.shading.factors(this.pose, this.before, this.now));
  }

  size() {
    if (this.fixed) return this.fixed;
    const { width, height } = this.stage.getBoundingClientRect();
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    return [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
  }

  /** Writes the values at a pixel. */
  read(x, y) {
    if (x < 0 || y < 0 || x >= this.canvas.width || y >= this.canvas.height) return;
    const [r, g, b, alpha] = this.splats.sums(0, x, y, 1, 1);
    const [u, v, depth] = this.splats.sums(1, x, y, 1, 1);
    const signed = (number) => `${number < 0 ? "−" : "+"}${Math.abs(number).toFixed(2)}`;
    const flow = this.head ? `flow ${signed(u)}, ${signed(v)} px (${Math.hypot(u, v).toFixed(2)})  ` : "";
    const far = alpha > 0.004 ? `${(depth / alpha).toFixed(3)} m` : "none";
    const color = [r, g, b].map((x) => Math.round(255 * Math.min(x, 1))).join(" ");
    this.readout.textContent = `x ${x}, y ${y}  ${flow}depth ${far}  alpha ${alpha.toFixed(2)}  colour ${color}`;
  }

  listen() {
    const { canvas } = this;
    const pointers = new Map();
    const ratio = () => canvas.width / canvas.getBoundingClientRect().width;
    canvas.onpointerdown = (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    };
    canvas.onpointerup = canvas.onpointercancel = (event) => pointers.delete(event.pointerId);
    canvas.onpointerleave = () => {
      this.pointer = null;
      this.readout.textContent = "";
    };
    canvas.onpointermove = (event) => {
      const box = canvas.getBoundingClientRect();
      this.pointer = [Math.floor((event.clientX - box.left) * ratio()), Math.floor((event.clientY - box.top) * ratio())];
      const before = pointers.get(event.pointerId);
      if (!before) {
        if (!this.settled) this.read(...this.pointer);
        return;
      }
      const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
      if (others.length) { // two fingers
        const distance = ([x, y]) => Math.hypot(x - others[0][0], y - others[0][1]);
        this.camera.zoom(distance(before) / Math.max(distance([event.clientX, event.clientY]), 1));
        this.camera.pan((dx * ratio()) / 2, (dy * ratio()) / 2, canvas.width, canvas.height);
      } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) {
        this.camera.pan(dx * ratio(), dy * ratio(), canvas.width, canvas.height);
      } else {
        this.camera.turn(-dx / 200, dy / 200);
      }
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      this.changed();
    };
    canvas.oncontextmenu = (event) => event.preventDefault();
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.camera.zoom(Math.exp(event.deltaY / 800));
      this.changed();
    }, { passive: false });
    document.addEventListener("keydown", (event) => isForPage(event) && this.key(event));
  }

  key(event) {
    const { state, head } = this;
    const inSlider = event.target.matches?.("input[type=range]");
    const last = (head?.timesteps ?? 1) - 1;
    const layers = [...this.layerChoice.querySelectorAll("button")].map((button) => button.dataset.key);
    const actions = {
      " ": () => this.play(),
      ArrowLeft: () => !inSlider && this.set({ t: Math.max(state.t - 1, 0), playing: false }),
      ArrowRight: () => !inSlider && this.set({ t: Math.min(state.t + 1, Math.max(last, 0)), playing: false }),
      a: () => head && this.set({ arrows: !state.arrows }),
      r: () => this.resetView(),
      f: () => {
        this.camera.upsideDown = !this.camera.upsideDown;
        this.changed();
      },
    };
    layers.forEach((layer, i) => (actions[i + 1] = () => this.set({ layer })));
    const action = actions[event.key] ?? actions[event.key.toLowerCase()];
    if (!action || (inSlider && event.key.startsWith("Arrow"))) return;
    if (event.key === " ") event.preventDefault();
    action();
  }

  /** What is shown, in the address, so that a link leads to it. */
  writeHash() {
    const { state, camera, head } = this;
    const parts = { layer: state.layer, to: state.to, arrows: Number(state.arrows), t: state.t };
    const units = state.units.flatMap((value, i) => (value ? [`${head.units[i].key}=${value}`] : []));
    const pose = [...state.gaze, ...state.turn];
    const view = [camera.yaw, camera.pitch, camera.distance, ...camera.centre].map((x) => Number(x.toFixed(4)));
    if (!state.playing) remember({ ...parts, units: units.join(","), pose: pose.join(","), view: view.join(",") });
  }

  readHash() {
    const hash = new URLSearchParams(location.hash.slice(1));
    const numbers = (key, count) => {
      const found = (hash.get(key) ?? "").split(",").map(Number);
      return found.length === count && found.every(Number.isFinite) ? found : null;
    };
    const { state, head, camera } = this;
    const layers = [...this.layerChoice.querySelectorAll("button")].map((button) => button.dataset.key);
    if (layers.includes(hash.get("layer"))) state.layer = hash.get("layer");
    if (["next", "rest"].includes(hash.get("to"))) state.to = hash.get("to");
    state.arrows = hash.get("arrows") === "1" && Boolean(head);
    const t = Number(hash.get("t"));
    if (head && Number.isInteger(t) && t >= 0 && t < head.timesteps) state.t = t;
    for (const [key, value] of (hash.get("units") ?? "").split(",").map((text) => text.split("="))) {
      const number = head ? head.units.findIndex((unit) => unit.key === key) : -1;
      if (number >= 0 && Number(value) >= 0 && Number(value) <= 1) state.units[number] = Number(value);
    }
    const pose = numbers("pose", 5);
    if (pose) [state.gaze, state.turn] = [pose.slice(0, 2), pose.slice(2)];
    const view = numbers("view", 6);
    if (view && view[2] > 0) [camera.yaw, camera.pitch, camera.distance, camera.centre] = [view[0], view[1], view[2], view.slice(3)];
    this.show();
  }
}

function longestFlow(before, after, camera) {
  const [r0, r1, r2] = camera.rows;
  const pixel = (v, i) => {
    const along = (row) => row[0] * v[i] + row[1] * v[i + 1] + row[2] * v[i + 2] + row[3];
    const z = Math.max(along(r2), NEAR);
    return [(camera.focal * along(r0)) / z, (camera.focal * along(r1)) / z];
  };
  let longest = 0;
  for (let i = 0; i < before.length; i += 3) {
    const [[x, y], [nextX, nextY]] = [pixel(before, i), pixel(after, i)];
    longest = Math.max(longest, (nextX - x) ** 2 + (nextY - y) ** 2);
  }
  return Math.sqrt(longest);
}
