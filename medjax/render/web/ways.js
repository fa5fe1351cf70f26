const BINS = 9;
const MOST_TIMES = 600;
const NEAR_M = 30; // from the pointer to the line that it names

/** Time-space diagram: positions over time, coloured by speed. */
class Ways extends Diagram {
  constructor(episode, theme, player) {
    const onClick = (seconds, share) => {
      player.seek(seconds);
      player.setCamera("free", share * episode.meta.road.length);
    };
    super({ end: episode.seconds, theme, label: `Time-space diagram under ${episode.meta.policy}`, onClick });
    this.episode = episode;
  }

  /** Time and place in words, and the nearest vehicle. */
  textAt(seconds, share) {
    const { episode } = this;
    const x = share * episode.meta.road.length;
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

  draw(context) {
    const { episode, theme } = this;
    const { length } = episode.meta.road;
    const toY = (x) => 5 + (1 - x / length) * (this.bottom - 8);
    const tick = roundStep(length / 1000, 4);
    const axis = { low: 0, high: length / 1000, tick, toY: (km) => toY(1000 * km), unit: " km" };
    drawAxes(context, theme, axis, this.width);
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
    for (const { frame, slot } of episode.ranOut) {
      const x = episode.tables.x.at(slot, frame);
      drawCross(context, this.toX(frame * episode.meta.tickSeconds), toY(x), 3, theme);
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
}
