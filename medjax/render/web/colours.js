const FAST_M_PER_S = 36;
const HARD_M_PER_S2 = 4;
const LONG_S = 30;
const CRAWL_M_PER_S = 0.5;
const AMBER = "#ff9f1c";
const BRAKES = "#e5383b";
const BRAKING_M_PER_S2 = -1;
const SIDEWAYS = 0.008; // least heading that shows as a lane change

/** Meanings of colours: a vehicle's share of the scale, 0 to 1, and the legend's words. */
const COLOURINGS = {
  charge: { words: "EV, charge 0 to 100 %" },
  speed: { words: `speed, 0 to ${FAST_M_PER_S} m/s`, share: (episode, slot) => speedOf(episode, slot) / FAST_M_PER_S },
  acceleration: {
    words: `braking by ${HARD_M_PER_S2} m/s² to accelerating by ${HARD_M_PER_S2}`,
    share: (episode, slot) => 0.5 + accelerationOf(episode, slot) / (2 * HARD_M_PER_S2),
  },
  waiting: { words: `standing for 0 to ${LONG_S} s`, share: (episode, slot) => stoodFor(episode, slot) / LONG_S },
};

/** Fill and text of a vehicle, as the page's colouring has it. */
function paint(episode, theme, slot) {
  const kind = episode.kindOf(slot);
  const { share } = COLOURINGS[theme.colouring];
  if (share) return theme.soc(share(episode, slot));
  if (kind === KIND.MED) return { fill: theme.med, text: theme.onMed };
  if (kind === KIND.GAS) return { fill: theme.gas, text: theme.ink };
  return theme.soc(episode.soc(slot, episode.frame));
}

function speedOf(episode, slot, frame = episode.frame) {
  return episode.tables.speed.at(slot, frame);
}

/** Acceleration over the last tick, m/s²; 0 for a vehicle that has just entered. */
function accelerationOf(episode, slot) {
  const { frame, frames, trackAt } = episode;
  if (frame < 1 || trackAt[slot * frames + frame - 1] !== episode.present[slot]) return 0;
  return (speedOf(episode, slot) - speedOf(episode, slot, frame - 1)) / episode.meta.tickSeconds;
}

/** How long a vehicle has stood still, s, at most `LONG_S`. */
function stoodFor(episode, slot) {
  const { frame, tracks, present } = episode;
  const earliest = Math.max(tracks[present[slot]].first, frame - LONG_S / episode.meta.tickSeconds);
  let since = frame;
  while (since >= earliest && speedOf(episode, slot, since) < CRAWL_M_PER_S) since -= 1;
  return (frame - since) * episode.meta.tickSeconds;
}

/** Lamps of a vehicle: brake lights, and indicators on the side of a lane change. */
function drawLamps(context, { left, top, width, height }, episode, slot) {
  const size = Math.max(2, 0.16 * height);
  if (accelerationOf(episode, slot) < BRAKING_M_PER_S2) {
    context.fillStyle = BRAKES;
    context.fillRect(left - 1, top, size, height);
  }
  const aside = episode.tilt[slot];
  if (Math.abs(aside) > SIDEWAYS && Math.floor(episode.frame * episode.meta.tickSeconds * 2) % 2 === 0) {
    context.fillStyle = AMBER;
    const y = aside > 0 ? top + height - size : top;
    context.fillRect(left, y, size, size);
    context.fillRect(left + width - size, y, size, size);
  }
}

/** Mean speeds along the road, as a band over its strip; slow is dark. */
function drawSpeeds(context, view, episode, theme) {
  cellSpeeds(episode).forEach((speed, cell) => {
    if (Number.isNaN(speed)) return;
    context.fillStyle = theme.soc(speed / FAST_M_PER_S).fill;
    const left = view.px(cell * CELL_M);
    context.fillRect(left, 0, Math.min(view.px((cell + 1) * CELL_M), view.right) - left, SPEEDS_PX);
  });
}
