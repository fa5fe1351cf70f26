const LANE_PX = { strip: 9, narrow: 20, wide: 34, low: 26 };
const TEXT_PX = 12;
const DASH_M = 6;
const PERIOD_M = 18;
const ARROWS_M = 54;
const SPEEDS_PX = 5; // height of the band of speeds over the strip
const CELL_M = 100;
const RULER_STEPS_M = [10, 20, 50, 100, 200, 500, 1000];

/** Metres to pixels: a rectangle of the canvas onto a stretch of road. */
class Window {
  constructor(left, top, width, lanePx, road) {
    Object.assign(this, { left, top, width, road });
    this.wholePerY = lanePx / road.laneWidth;
    this.wholeTop = -0.75 * road.laneWidth;
    this.wholeDepth = road.shoulder + 0.4 * road.laneWidth - this.wholeTop; // m
    this.height = this.wholePerY * this.wholeDepth;
    this.stretch(1, 0);
    this.show(0, road.length);
  }

  /** Scales what lies across the road, around `y` m as far as there is something to see. */
  stretch(scale, y) {
    this.perY = this.wholePerY * scale;
    const depth = this.height / this.perY;
    const last = this.wholeTop + this.wholeDepth - depth;
    const middle = y - depth / 2;
    this.topY = scale > 1 ? Math.min(Math.max(middle, this.wholeTop), last) : this.wholeTop + (this.wholeDepth - depth) / 2;
  }

  show(start, span) {
    this.start = start;
    this.span = span;
    this.perX = this.width / span;
  }

  px(x) {
    return this.left + (x - this.start) * this.perX;
  }

  py(y) {
    return this.top + (y - this.topY) * this.perY;
  }

  metres(px) {
    return this.start + (px - this.left) / this.perX;
  }

  get right() {
    return this.left + this.width;
  }

  get bottom() {
    return this.top + this.height;
  }
}

/** Lanes beside the road: their end at a ramp or exit, m, the other end, and the side on which the access road is. */
function laneEnds({ ramps, mergeLength, exits, exitLane }) {
  return [
    ...ramps.map((x) => ({ at: x, other: x + mergeLength, side: -1 })),
    ...exits.map((x) => ({ at: x, other: x - exitLane, side: 1 })),
  ];
}

/** Lanes, and beside them those of ramps and exits. */
function drawAsphalt(context, view, theme, marked) {
  const { road } = view;
  const half = road.laneWidth / 2;
  const lane = road.laneWidth * view.perY;
  const edge = view.py(road.lanes * road.laneWidth - half);
  context.fillStyle = theme.grass;
  context.fillRect(view.left, view.top, view.width, view.height);
  context.fillStyle = theme.asphalt;
  for (const { at, other, side } of laneEnds(road)) {
    const [near, far, run] = [view.px(at), view.px(other), 1.6 * side * lane];
    const access = [[near + run, view.bottom], [near, edge]];
    const lanes = [[far, edge], [far, edge + lane], [near, edge + lane]];
    tracePath(context, [...access, ...lanes, [near + 0.4 * run, view.bottom]]);
    context.fill();
  }
  const start = Math.max(view.left, view.px(0));
  const end = Math.min(view.right, view.px(road.length));
  context.fillRect(start, view.py(-half), end - start, edge - view.py(-half));
  if (marked) drawMarkings(context, view, theme, start, end);
}

function drawMarkings(context, view, theme, start, end) {
  const { road } = view;
  const half = road.laneWidth / 2;
  const line = (y) => context.fillRect(start, view.py(y) - 1, end - start, 2);
  context.fillStyle = theme.marking;
  const first = Math.floor(view.start / PERIOD_M) * PERIOD_M;
  for (let lane = 1; lane < road.lanes; lane += 1) {
    const y = view.py(lane * road.laneWidth - half);
    for (let x = first; x < view.start + view.span; x += PERIOD_M) {
      context.fillRect(view.px(x), y - 1, DASH_M * view.perX, 2);
    }
  }
  context.globalAlpha = 0.4;
  for (let lane = 0; lane < road.lanes; lane += 1) drawArrows(context, view, lane * road.laneWidth);
  context.globalAlpha = 1;
  context.fillStyle = theme.edge;
  line(-half);
  line(road.lanes * road.laneWidth - half);
  context.fillStyle = theme.asphalt; // the edge is broken where vehicles may cross it
  const y = view.py(road.lanes * road.laneWidth - half);
  for (const { at, other } of laneEnds(road)) {
    for (let x = Math.min(at, other); x < Math.max(at, other); x += 9) {
      context.fillRect(view.px(x), y - 1, DASH_M * view.perX, 2);
    }
  }
}

/** Arrows on a lane in the direction of travel. */
function drawArrows(context, view, y) {
  const { road } = view;
  const [long, wide] = [3 * view.perX, 0.16 * road.laneWidth * view.perY];
  const middle = view.py(y);
  const first = Math.max(0, Math.floor(view.start / ARROWS_M) * ARROWS_M);
  for (let x = first; x < Math.min(view.start + view.span, road.length); x += ARROWS_M) {
    const tip = view.px(x) + long;
    tracePath(context, [[tip - long, middle - wide], [tip, middle], [tip - long, middle + wide]]);
    context.fill();
  }
}

/** Texts centred at `[x, text]` from left to right, without those that do not fit. */
function drawLabels(context, places, y, left, right) {
  context.textAlign = "center";
  context.textBaseline = "middle";
  let free = left;
  for (const [place, text] of places) {
    const half = context.measureText(text).width / 2;
    const x = Math.min(Math.max(place, left + half), right - half);
    if (x - half < free || Math.abs(x - place) > half + 1) continue;
    context.fillText(text, x, y);
    free = x + half + 8;
  }
}

/** One episode's picture: the road as a strip, and a camera on a stretch of it. */
class RoadView {
  /** `low` leaves room for a second picture. */
  constructor(canvas, episode, theme, low) {
    Object.assign(this, { canvas, episode, theme, low });
    this.resize();
  }

  resize() {
    const { road } = this.episode.meta;
    const guess = this.canvas.clientWidth;
    const lanePx = guess < 700 ? LANE_PX.narrow : this.low ? LANE_PX.low : LANE_PX.wide;
    const pad = 4;
    this.strip = new Window(pad, SPEEDS_PX + 2, guess - 2 * pad, LANE_PX.strip, road);
    const top = this.strip.bottom + TEXT_PX + 12;
    this.camera = new Window(0, top, guess, lanePx, road);
    const height = Math.ceil(this.camera.bottom + TEXT_PX + 8);
    const fitted = fitCanvas(this.canvas, height, { alpha: false });
    Object.assign(this, { context: fitted.context, width: fitted.width, height: fitted.height });
    this.span = guess / (this.camera.wholePerY / road.exaggeration);
  }

  /** Points the camera at a place on the road; each 1 of `zoom` doubles the scale, around `y` m across. */
  aim(center, zoom, y = 0) {
    const { length } = this.episode.meta.road;
    const span = Math.min(this.span * 2 ** -zoom, length);
    this.camera.stretch(this.span / span, y);
    const start = Math.min(Math.max(center - span / 2, 0), length - span);
    this.camera.show(start, span);
    this.center = start + span / 2;
  }

  draw(seconds, selected) {
    const { context, episode, theme, strip, camera } = this;
    episode.look(seconds);
    context.fillStyle = theme.paper;
    context.fillRect(0, 0, this.width, this.height);
    context.save();
    context.beginPath();
    context.rect(camera.left, camera.top, camera.width, camera.height);
    context.clip();
    drawAsphalt(context, camera, theme, true);
    drawClose(context, camera, episode, theme, selected);
    context.restore();
    this._ruler();
    drawSpeeds(context, strip, episode, theme);
    drawAsphalt(context, strip, theme, false);
    drawFar(context, strip, episode, theme, selected);
    context.strokeStyle = theme.accent;
    context.lineWidth = 2;
    const left = strip.px(camera.start);
    context.strokeRect(left, strip.top + 1, camera.span * strip.perX, strip.height - 2);
    context.fillStyle = theme.faint;
    context.font = `${TEXT_PX}px system-ui, sans-serif`;
    const { ramps, exits, length } = episode.meta.road;
    const named = (places, name) => places.map((x, i) => [strip.px(x), `${name} ${i + 1}`]);
    const ends = [strip.px(length), `${Number((length / 1000).toFixed(2))} km`];
    const labels = [...named(ramps, "ramp"), ...named(exits, "exit"), ends].sort((a, b) => a[0] - b[0]);
    drawLabels(context, labels, strip.bottom + TEXT_PX / 2 + 3, strip.left, strip.right);
  }

  _ruler() {
    const { context, camera, theme } = this;
    const step = RULER_STEPS_M.find((metres) => metres * camera.perX > 80) ?? RULER_STEPS_M.at(-1);
    const labels = [];
    context.fillStyle = theme.edge;
    for (let x = Math.ceil(camera.start / step) * step; x <= camera.start + camera.span; x += step) {
      context.fillRect(camera.px(x), camera.bottom - 1, 1, 5);
      labels.push([camera.px(x), `${x} m`]);
    }
    context.fillStyle = theme.faint;
    context.font = `${TEXT_PX}px system-ui, sans-serif`;
    drawLabels(context, labels, camera.bottom + TEXT_PX / 2 + 4, 4, this.width - 4);
  }

  /** The part that a point lies in: `strip`, `camera` or null. */
  partAt(y) {
    if (y < this.strip.bottom + TEXT_PX + 6) return "strip";
    return y < this.camera.bottom ? "camera" : null;
  }

  /** The vehicle nearest to a point, within reach of a finger or some px; null for none. */
  vehicleAt(x, y, reach = this.partAt(y) === "strip" ? 8 : 16) {
    const view = this.partAt(y) === "strip" ? this.strip : this.camera;
    const { episode } = this;
    let best = null;
    let least = reach;
    for (let slot = 0; slot < episode.meta.numVehicles; slot += 1) {
      const index = episode.present[slot];
      if (index < 0) continue;
      const body = bodyOf(view, episode, slot);
      const away = Math.hypot(
        Math.max(body.left - x, 0, x - body.left - body.width),
        Math.max(body.top - y, 0, y - body.top - body.height),
      );
      if (away < least) [best, least] = [episode.tracks[index], away];
    }
    return best;
  }
}
