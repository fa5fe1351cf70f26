/** Colours of the style sheet, light or dark as the reader prefers, for canvases. */
class Theme {
  constructor(socScale) {
    this.changed = () => {};
    this.colouring = "charge"; // of `COLOURINGS`
    const scale = socScale.map((hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)));
    this._soc = Array.from({ length: 101 }, (_, percent) => {
      const place = (percent / 100) * (scale.length - 1);
      const low = Math.min(Math.floor(place), scale.length - 2);
      const rgb = scale[low].map((a, i) => Math.round(a + (place - low) * (scale[low + 1][i] - a)));
      const light = 0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2] > 112; // as `colors.text_color`
      return { fill: `rgb(${rgb})`, text: light ? "#000000" : "#ffffff" };
    });
    this._read();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this._read();
      this.changed();
    });
  }

  _read() {
    const style = getComputedStyle(document.documentElement);
    const names = "paper ink faint grass asphalt marking edge med gas out warning accent first second line";
    for (const name of names.split(" ")) this[name] = style.getPropertyValue(`--${name}`).trim();
    this.onMed = style.getPropertyValue("--on-med").trim();
  }

  /** `{fill, text}` of an EV with a state of charge. */
  soc(share) {
    return this._soc[Math.round(100 * Math.min(Math.max(share, 0), 1))];
  }
}

/** Makes an element. */
function element(tag, properties = {}, children = []) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

/** A canvas that screen readers announce by its label. */
function picture(label) {
  const canvas = element("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", label);
  return canvas;
}

/** An item of a list, which is a button. */
function listButton(textContent, act, properties = {}) {
  const button = element("button", { type: "button", textContent });
  button.addEventListener("click", act);
  return element("li", properties, [button]);
}

/** The mark of an episode's colour. */
function keyOf(which, look = "") {
  return element("span", { className: `key ${LINE_COLORS[which]}${look}` });
}

/** Starts a path of lines through points. */
function tracePath(context, ...lines) {
  context.beginPath();
  for (const [first, ...rest] of lines) {
    context.moveTo(...first);
    for (const point of rest) context.lineTo(...point);
  }
}

/** `m:ss`, or `m:ss.dd`. */
function clockText(seconds, digits = 0) {
  const units = Math.floor(seconds * 10 ** digits + 1e-6);
  const whole = Math.floor(units / 10 ** digits);
  const rest = digits ? "." + String(units % 10 ** digits).padStart(digits, "0") : "";
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}${rest}`;
}

/** Fits a canvas to its place in the page; returns its context in CSS pixels, and its size. */
function fitCanvas(canvas, height, options = {}) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = canvas.clientWidth;
  if (height !== undefined) canvas.style.height = `${height}px`;
  const high = height ?? canvas.clientHeight;
  canvas.width = Math.max(1, Math.round(width * ratio));
  canvas.height = Math.max(1, Math.round(high * ratio));
  const context = canvas.getContext("2d", options);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height: high };
}
