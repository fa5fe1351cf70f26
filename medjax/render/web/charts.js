const AXIS_PX = 14;
const LEFT_PX = 40;

/** A round step for about `count` ticks over a range. */
function roundStep(range, count) {
  const rough = range / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= rough);
}

/** Lines across at round numbers, named at the left. */
function drawAxes(context, theme, { low, high, tick, toY, unit = "" }, width) {
  context.font = "11px system-ui, sans-serif";
  context.fillStyle = theme.faint;
  context.strokeStyle = theme.line;
  context.lineWidth = 1;
  context.textAlign = "right";
  context.textBaseline = "middle";
  const digits = Math.max(0, -Math.floor(Math.log10(tick) + 1e-9));
  for (let v = low; v <= high + tick / 2; v += tick) {
    const y = Math.round(toY(v)) + 0.5;
    tracePath(context, [[LEFT_PX, y], [width - 4, y]]);
    context.stroke();
    context.fillText((Math.abs(v) < 1e-9 ? 0 : v).toFixed(digits) + unit, LEFT_PX - 4, Math.max(toY(v), 6));
  }
}

/** Times under a plot. */
function drawTimes(context, theme, { start, end, toX }, width, height) {
  const seconds = [10, 20, 30, 60, 120, 300, 600, 1200, 3600];
  const wide = (60 * (end - start)) / width;
  const step = seconds.find((s) => s >= wide) ?? seconds.at(-1);
  const labels = [];
  for (let t = Math.ceil(start / step) * step; t <= end; t += step) labels.push([toX(t), clockText(t)]);
  context.fillStyle = theme.faint;
  drawLabels(context, labels, height - AXIS_PX / 2 + 2, LEFT_PX - 14, width);
}

/** A diagram over time, drawn once; only a cursor moves. Subclasses draw, and put a place into words. */
class Diagram {
  /** `onClick` gets seconds, and the share of the height. */
  constructor({ start = 0, end, theme, label, onClick }) {
    Object.assign(this, { start, end, theme, label });
    this.canvas = picture(label);
    this.cursor = element("div", { className: "cursor" });
    this.root = element("div", { className: "plot" }, [this.canvas, this.cursor]);
    this.root.addEventListener("click", (event) => onClick(...this._placeAt(event)));
    this.root.addEventListener("pointermove", (event) => {
      this.root.title = this.textAt(...this._placeAt(event));
    });
  }

  _placeAt({ offsetX, offsetY }) {
    const share = (offsetX - LEFT_PX) / Math.max(1, this.width - LEFT_PX - 4);
    const up = 1 - (offsetY - 5) / Math.max(1, this.bottom - 8);
    const [along, height] = [share, up].map((each) => Math.min(Math.max(each, 0), 1));
    return [this.start + along * (this.end - this.start), height];
  }

  resize() {
    const { context, width, height } = fitCanvas(this.canvas);
    Object.assign(this, { width, bottom: height - AXIS_PX });
    this.toX = (t) => LEFT_PX + ((t - this.start) / (this.end - this.start || 1)) * (width - LEFT_PX - 4);
    context.clearRect(0, 0, width, height);
    this.draw(context);
    drawTimes(context, this.theme, this, width, height);
  }

  moveTo(seconds) {
    if (!this.toX) return;
    const inside = seconds >= this.start && seconds <= this.end;
    this.cursor.style.visibility = inside ? "visible" : "hidden";
    this.cursor.style.transform = `translateX(${this.toX(seconds)}px)`;
  }
}

/** Lines over time. */
class Plot extends Diagram {
  /**
   * `lines`: {values(i), count, step (s), color (a name of the theme), dashed, name}; `least` is the least range of the
   * axis, so that small changes look small; `onSeek` gets seconds.
   */
  constructor({ lines, least = 1, onSeek, ...where }) {
    super({ ...where, onClick: (seconds) => onSeek(seconds) });
    Object.assign(this, { lines, least });
  }

  /** The lines at a time, in words. */
  textAt(seconds) {
    const values = this.lines.map(({ values, count, step, start = 0, name }) => {
      const value = values(Math.min(Math.max(Math.floor((seconds - start) / step + 1e-6), 0), count - 1));
      return `${name ? `${name} ` : ""}${Number.isNaN(value) ? "–" : value.toFixed(2)}`;
    });
    return `${this.label}: ${values.join(", ")} at ${clockText(seconds)}; click to go there`;
  }

  draw(context) {
    this._range();
    const toY = (v) => 5 + (1 - (v - this.low) / (this.high - this.low)) * (this.bottom - 8);
    drawAxes(context, this.theme, { low: this.low, high: this.high, tick: this.tick, toY }, this.width);
    for (const line of this.lines) this._line(context, line, toY);
  }

  _range() {
    let [low, high] = [Infinity, -Infinity];
    for (const { values, count } of this.lines) {
      for (let i = 0; i < count; i += 1) {
        const value = values(i);
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (low > high) [low, high] = [0, 1];
    if (low > 0 && low < 0.6 * high) low = 0;
    const lacking = this.least - (high - low);
    if (lacking > 0) {
      const below = low >= 0 ? Math.min(lacking / 2, low) : lacking / 2; // not below 0 just for this
      [low, high] = [low - below, high + lacking - below];
    }
    this.tick = roundStep(high - low, 3);
    this.low = Math.floor(low / this.tick + 1e-9) * this.tick;
    this.high = Math.ceil(high / this.tick - 1e-9) * this.tick;
  }

  _line(context, { values, count, step, start = 0, color, dashed }, toY) {
    context.strokeStyle = this.theme[color];
    context.lineWidth = 1.6;
    context.setLineDash(dashed ? [4, 3] : []);
    context.beginPath();
    let pen = false;
    for (let i = 0; i < count; i += 1) {
      const value = values(i);
      const known = !Number.isNaN(value);
      if (known) context[pen ? "lineTo" : "moveTo"](this.toX(start + i * step), toY(value));
      pen = known;
    }
    context.stroke();
    context.setLineDash([]);
  }
}

const LINE_COLORS = ["first", "second"];

/** A chart of an episode, or of two on the same axes, with the numbers of now. */
class Chart {
  constructor(number, episodes, theme, onSeek) {
    this.number = number;
    this.episodes = episodes;
    this.about = episodes[0].meta.charts[number];
    const { title, unit, labels } = this.about;
    const lines = [];
    this.outputs = [];
    const heading = element("span", { className: "title", textContent: unit ? `${title} (${unit})` : title });
    const values = element("span");
    const several = episodes.length > 1;
    episodes.forEach((episode, which) => {
      labels.forEach((label, row) => {
        const table = episode.tables[`chart${number}`];
        const name = [several ? episode.meta.policy : "", label].join(" ").trim();
        const look = { color: LINE_COLORS[which], dashed: row > 0, name };
        lines.push({ values: (i) => table.at(row, i), count: table.times, step: episode.decisionSeconds, ...look });
        const output = element("output");
        output.setAttribute("aria-live", "off"); // only the announcer speaks
        const parts = [keyOf(which, row ? " dashed" : ""), label ? `${label} ` : "", output];
        values.append(element("span", { className: "value" }, parts), " ");
        this.outputs.push({ output, table, row });
      });
    });
    const { least } = this.about;
    this.plot = new Plot({ lines, end: episodes[0].seconds, least, theme, label: `${title} over time`, onSeek });
    this.root = element("figure", {}, [element("figcaption", {}, [heading, values]), this.plot.root]);
  }

  resize() {
    this.plot.resize();
  }

  show(seconds) {
    this.plot.moveTo(seconds);
    const point = Math.floor(seconds / this.episodes[0].decisionSeconds + 1e-6);
    if (point === this.point) return;
    this.point = point;
    for (const { output, table, row } of this.outputs) {
      const value = table.at(row, Math.min(point, table.times - 1));
      output.value = Number.isNaN(value) ? "–" : value.toFixed(this.about.digits);
    }
  }
}
