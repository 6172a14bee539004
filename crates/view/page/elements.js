// Small parts of the page.

/** An element with attributes, handlers (`onclick`) and children. */
function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made[key] = value;
    else if (key.startsWith("aria-")) made.setAttribute(key, String(value));
    else if (value !== false && value !== null) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children);
  return made;
}

/** A labelled slider; `onchange` gets its number. */
function slider(name, { min = 0, max = 1, step = 0.01, value = 0, digits = 2, onchange }) {
  const output = element("output", {}, value.toFixed(digits));
  const input = element("input", { type: "range", min, max, step, value, "aria-label": name });
  input.oninput = () => {
    output.textContent = input.valueAsNumber.toFixed(digits);
    onchange(input.valueAsNumber);
  };
  const whole = element("label", { class: "slider" }, element("span", {}, name), input, output);
  whole.set = (number) => {
    input.value = number;
    output.textContent = Number(number).toFixed(digits);
  };
  return whole;
}

/** Buttons of which one is pressed. */
function choice(name, options, chosen, onchange) {
  const buttons = options.map(([key, text]) => element("button", { type: "button", "data-key": key, onclick: () => set(key, true) }, text));
  const set = (key, tell) => {
    buttons.forEach((button) => button.setAttribute("aria-pressed", button.dataset.key === key));
    if (tell) onchange(key);
  };
  set(chosen, false);
  const whole = element("div", { class: "choice", role: "group", "aria-label": name }, ...buttons);
  whole.set = (key) => set(key, false);
  return whole;
}

function checkbox(name, checked, onchange) {
  const input = element("input", { type: "checkbox", checked, onchange: () => onchange(input.checked) });
  const whole = element("label", { class: "check" }, input, name);
  whole.set = (value) => (input.checked = value);
  return whole;
}

/** Calls `step(seconds)` with each picture of the screen while it returns true. */
function animate(step) {
  let before = performance.now();
  const next = async (now) => {
    const goesOn = await step((now - before) / 1000);
    before = now;
    if (goesOn) requestAnimationFrame(next);
  };
  requestAnimationFrame(next);
}

/** Puts what is shown into the address, unless the page is a part of another one, which has no address of its own. */
function remember(facts) {
  if (location.protocol !== "about:") history.replaceState(null, "", `#${new URLSearchParams(facts)}`);
}

/** Whether a key is meant for the page and not for a control. */
function isForPage(event) {
  const inControl = event.target.matches?.("input[type=number], input[type=text], select, textarea");
  return !(inControl || event.ctrlKey || event.metaKey || event.altKey);
}
