const BINS = 9;
const MOST_TIMES = 600;
const NEAR_M = 30; // that a line is from the pointer which tells whose it is

/** Time-space diagram: where everybody was when, coloured by speed; drawn once, only a cursor moves. */
class Ways {
  constructor(episode, theme, player) {
    Object.assign(this, { episode, theme });
    this.canvas = element("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `Everybody's way under ${episode.meta.policy}`);
    this.cursor = element("div", { className: "cursor" });
    this.root = element("div", { className: "plot" }, [this.canvas, this.cursor]);
    this.root.addEventListener("click", (event) => {
      const [seconds, x] = this._placeAt(event);
      player.seek(seconds);
      player.setCamera("free", x);
    });
    this.root.addEventListener("pointermove", (event) => {
      this.root.title = this.textAt(...this._placeAt(event));
    });
  }

  _placeAt({ offsetX, offsetY }) {
    const share = (offsetX - LEFT_PX) / Math.max(1, this.width - LEFT_PX - 4);
    const up = 1 - (offsetY - 5) / Math.max(1, this.bottom - 8);
    const { seconds, meta } = this.episode;
    return [Math.min(Math.max(share, 0), 1) * seconds, Math.min(Math.max(up, 0), 1) * meta.road.length];
  }

  /** Time and place in words, and who is nearest to it. */
  textAt(seconds, x) {
    const { episode } = this;
    const { tables, meta, frames, trackAt, tracks } = episode;
    const frame = episode.frameAt(seconds);
    let [who, least] = ["", NEAR_M];
    for (let slot = 0; slot < meta.numVehicles; slot += 1) {
      const index = trackAt[slot * frames + frame];
      const away = Math.abs(tables.x.at(slot, frame) - x);
      if (index >= 0 && away < least) {
        [who, least] = [`: ${tracks[index].name}, ${speedOf(episode, slot, frame).toFixed(1)} m/s`, away];
      }
    }
    return `${x.toFixed(0)} m at ${clockText(seconds)}${who}; click to go there`;
  }

  resize() {
    const { episode, theme } = this;
    const { context, width, height } = fitCanvas(this.canvas);
    Object.assign(this, { width, bottom: height - AXIS_PX });
    const { length } = episode.meta.road;
    this.toX = (t) => LEFT_PX + (t / (episode.seconds || 1)) * (width - LEFT_PX - 4);
    const toY = (x) => 5 + (1 - x / length) * (this.bottom - 8);
    context.clearRect(0, 0, width, height);
    const tick = roundStep(length / 1000, 4);
    drawAxes(context, theme, { low: 0, high: length / 1000, tick, toY: (km) => toY(1000 * km), unit: " km" }, width);
    drawTimes(context, theme, { start: 0, end: episode.seconds, toX: this.toX }, width, height);
    const paths = Array.from({ length: BINS }, () => new Path2D());
    const meds = new Path2D();
    for (const track of episode.tracks) this._trace(track, paths, meds, toY);
    context.lineWidth = 1;
    paths.forEach((path, bin) => {
      context.strokeStyle = theme.soc(bin / (BINS - 1)).fill;
      context.stroke(path);
    });
    context.lineWidth = 2.5;
    context.strokeStyle = theme.med;
    context.stroke(meds);
    for (const { gone, x } of episode.ranOut) {
      drawCross(context, this.toX(gone * episode.meta.tickSeconds), toY(x), 3, theme);
    }
  }

  /** A track's line, in pieces by speed. */
  _trace(track, paths, meds, toY) {
    const { episode } = this;
    const { tables, meta } = episode;
    const every = Math.max(1, Math.ceil(episode.frames / MOST_TIMES));
    let [x, y] = [this.toX(track.first * meta.tickSeconds), toY(tables.x.at(track.slot, track.first))];
    for (let frame = track.first + every; frame - every < track.last; frame += every) {
      const here = Math.min(frame, track.last);
      const bin = Math.round((BINS - 1) * Math.min(speedOf(episode, track.slot, here) / FAST_M_PER_S, 1));
      const path = track.kind === KIND.MED ? meds : paths[bin];
      path.moveTo(x, y);
      [x, y] = [this.toX(here * meta.tickSeconds), toY(tables.x.at(track.slot, here))];
      path.lineTo(x, y);
    }
  }

  show(seconds) {
    if (this.toX) this.cursor.style.transform = `translateX(${this.toX(seconds)}px)`;
  }
}
