const TRAIL_S = 2;
const LONG_TRAIL_S = 10; // of the selected vehicle
const LEAST_PX = 9; // length of a body that is worth a text
const FAR = [
  { least: 9, share: 1.0 },
  { least: 5, share: 0.8 },
  { least: 3, share: 0.6 },
]; // by kind: least length of a mark on the strip, px, and its share of a lane

/** Outline of a vehicle, px. */
function bodyOf(view, episode, slot) {
  const { body } = episode.tracks[episode.present[slot]];
  const width = body.length * view.perX;
  const height = body.width * view.perY;
  const left = view.px(episode.x[slot]) - width;
  return { left, top: view.py(episode.y[slot]) - height / 2, width, height };
}

function isInView(view, { left, width }) {
  return left <= view.right && left + width >= view.left;
}

function drawCross(context, x, y, radius, theme) {
  const lines = [-radius, radius].map((dy) => [[x - radius, y - dy], [x + radius, y + dy]]);
  strokeLines(context, theme.paper, radius, lines);
  strokeLines(context, theme.out, radius / 2, lines);
}

function strokeLines(context, color, width, lines) {
  context.strokeStyle = color;
  context.lineWidth = width;
  tracePath(context, ...lines);
  context.stroke();
}

/** A cross on the shoulder for each EV that ran out. */
function drawRanOut(context, view, episode, theme, radius) {
  const y = view.py(episode.meta.road.shoulder);
  for (const { x } of episode.crosses()) {
    const px = view.px(x);
    if (px >= view.left && px <= view.right) drawCross(context, px, y, radius, theme);
  }
}

/** A warning triangle over each vehicle that an incident makes stand. */
function drawBrokenDown(context, view, episode, theme, radius) {
  for (const [slot, first, after] of episode.meta.brokenDown) {
    if (episode.frame < first || episode.frame >= after) continue;
    const body = bodyOf(view, episode, slot);
    if (!isInView(view, body)) continue;
    const [x, y] = [body.left + body.width / 2, body.top + body.height / 2];
    tracePath(context, [[x, y - radius], [x + radius, y + 0.8 * radius], [x - radius, y + 0.8 * radius]]);
    context.closePath();
    context.fillStyle = theme.warning;
    context.fill();
    context.strokeStyle = theme.ink;
    context.lineWidth = 1.5;
    context.stroke();
  }
}

/** Marks on the strip, longer and wider than its scale; MEDs and EVs lie on top. */
function drawFar(context, view, episode, theme, selected) {
  const lane = episode.meta.road.laneWidth * view.perY;
  for (let slot = episode.meta.numVehicles - 1; slot >= 0; slot -= 1) {
    if (episode.present[slot] < 0) continue;
    const { least, share } = FAR[episode.kindOf(slot)];
    const body = bodyOf(view, episode, slot);
    const width = Math.max(least, body.width);
    const height = share * lane;
    const left = Math.max(body.left + body.width - width, view.left);
    const top = body.top + (body.height - height) / 2;
    context.fillStyle = paint(episode, theme, slot).fill;
    context.fillRect(left, top, width, height);
    if (episode.kindOf(slot) !== KIND.GAS) {
      context.strokeStyle = theme.ink; // dark blue on dark asphalt is hard to see
      context.lineWidth = 0.7;
      context.strokeRect(left, top, width, height);
    }
    if (selected && episode.present[slot] === selected.index) {
      context.strokeStyle = theme.accent;
      context.lineWidth = 2;
      context.strokeRect(left - 3, top - 3, width + 6, height + 6);
    }
  }
  drawBrokenDown(context, view, episode, theme, 6);
  drawRanOut(context, view, episode, theme, 4);
}

/** Slots, ways, links, and vehicles with their charge. */
function drawClose(context, view, episode, theme, selected) {
  const slots = episode.slots();
  const waits = slots.filter(({ link }) => link && !link.charging);
  drawTrails(context, view, episode, theme, selected, waits);
  drawSlots(context, view, episode, theme, selected, slots);
  drawBookings(context, view, episode, theme, waits);
  for (const { link } of slots) if (link?.charging) drawBoom(context, view, episode, theme, link);
  for (let slot = episode.meta.numVehicles - 1; slot >= 0; slot -= 1) {
    if (episode.present[slot] < 0) continue;
    const body = bodyOf(view, episode, slot);
    if (!isInView(view, body)) continue;
    const isSelected = selected !== null && episode.present[slot] === selected.index;
    const tilt = episode.tilt[slot] * (view.perY / view.perX);
    const back = -episode.tilt[slot] * (view.perX / view.perY);
    const [x, y] = [body.left + body.width / 2, body.top + body.height / 2];
    context.save();
    context.transform(1, tilt, back, 1, -back * y, -tilt * x);
    drawBody(context, body, episode, theme, slot, isSelected);
    drawLamps(context, body, episode, slot);
    context.restore();
  }
  drawCharges(context, view, episode, theme);
  drawBrokenDown(context, view, episode, theme, 9);
  drawRanOut(context, view, episode, theme, 7);
}

/** Trails of the last seconds: pale and short for MEDs and EVs on their way to a slot, long for the selected vehicle. */
function drawTrails(context, view, episode, theme, selected, waits) {
  const meds = Array.from({ length: episode.meta.numMeds }, (_, med) => med);
  const tracksOf = (slots) => slots.map((slot) => episode.tracks[episode.present[slot]]).filter(Boolean);
  context.lineWidth = 2;
  context.setLineDash([2, 4]); // solid lines mean charging
  context.globalAlpha = 0.6;
  context.strokeStyle = theme.med;
  traceWays(context, view, episode, tracksOf(meds), TRAIL_S);
  context.strokeStyle = theme.ink;
  traceWays(context, view, episode, tracksOf(waits.map(({ link }) => link.slot)), TRAIL_S);
  context.globalAlpha = 1;
  context.strokeStyle = theme.accent;
  if (selected) traceWays(context, view, episode, [selected], LONG_TRAIL_S);
  context.setLineDash([]);
}

/** Lines where tracks were in the last seconds. */
function traceWays(context, view, episode, tracks, seconds) {
  const { tickSeconds } = episode.meta;
  context.beginPath();
  for (const track of tracks) {
    const place = (tick) => {
      const [x, y] = episode.placeAt(track, tick);
      return [view.px(x), view.py(y)];
    };
    const last = Math.min(episode.looked / tickSeconds, track.last);
    const first = Math.max(track.first, last - seconds / tickSeconds);
    if (first >= last || place(last)[0] < view.left || place(first)[0] > view.right) continue;
    context.moveTo(...place(first));
    for (let tick = Math.floor(first) + 1; tick < last; tick += 1) context.lineTo(...place(tick));
    context.lineTo(...place(last));
  }
  context.stroke();
}

/** Outlines of slots: dashed if free, solid if booked, in the accent colour if booked by the selected vehicle. */
function drawSlots(context, view, episode, theme, selected, slots) {
  const width = episode.meta.slotBody.length * view.perX;
  const height = episode.meta.slotBody.width * view.perY;
  for (const { x, y, link } of slots) {
    const left = view.px(x) - width;
    if (!isInView(view, { left, width }) || link?.charging) continue; // a charging EV fills its slot
    const own = link && selected && episode.present[link.slot] === selected.index;
    context.strokeStyle = own ? theme.accent : link ? theme.ink : theme.edge;
    context.lineWidth = own ? 2 : 1;
    context.setLineDash(link ? [] : [3, 3]);
    context.strokeRect(left, view.py(y) - height / 2, width, height);
  }
  context.setLineDash([]);
}

/** Bookings: a dashed line from an EV to the middle of its slot. */
function drawBookings(context, view, episode, theme, waits) {
  const half = (episode.meta.slotBody.length / 2) * view.perX;
  context.setLineDash([6, 5]);
  const lines = waits.map(({ x, y, link }) => {
    const { left, top, width, height } = bodyOf(view, episode, link.slot);
    return [[left + width / 2, top + height / 2], [view.px(x) - half, view.py(y)]];
  });
  strokeLines(context, theme.ink, 1.5, lines);
  context.setLineDash([]);
}

/** Charging: the boom between two panels, bumper to bumper or side to side. */
function drawBoom(context, view, episode, theme, { slot, med, panel }) {
  const [from, to] = [med, slot].map((each) => {
    const { left, top, width, height } = bodyOf(view, episode, each);
    return { x: left + width / 2, y: top + height / 2, halfLength: width / 2, halfWidth: height / 2 };
  });
  const [, aside] = episode.meta.slots[panel];
  const along = aside === 0;
  const side = Math.sign(along ? to.x - from.x : to.y - from.y);
  const face = (body, sign) =>
    along ? [body.x + sign * body.halfLength, body.y] : [body.x, body.y + sign * body.halfWidth];
  const ends = [face(from, side), face(to, -side)];
  const reach = Math.max(3, Math.min(from.halfWidth, to.halfWidth) * 0.7);
  const panels = ends.map(([x, y]) =>
    along ? [[x, y - reach], [x, y + reach]] : [[x - reach, y], [x + reach, y]],
  );
  strokeLines(context, theme.paper, 8, [ends, ...panels]);
  strokeLines(context, theme.med, 4, [ends, ...panels]);
}

function drawBody(context, { left, top, width, height }, episode, theme, slot, isSelected) {
  const kind = episode.kindOf(slot);
  const colors = paint(episode, theme, slot);
  context.fillStyle = colors.fill;
  const isOutlined = kind === KIND.MED && colors.fill !== theme.med; // MEDs stay green under any colouring
  context.strokeStyle = isOutlined ? theme.med : kind === KIND.GAS ? theme.edge : theme.ink;
  context.lineWidth = isOutlined ? 3 : 1;
  context.beginPath();
  context.roundRect(left, top, width, height, 0.22 * height);
  context.fill();
  context.stroke();
  context.fillStyle = context.strokeStyle;
  const pane = Math.min(0.14 * height, 0.1 * width);
  context.fillRect(left + width - 2 * pane, top + 0.16 * height, pane, 0.68 * height);
  if (isSelected) {
    context.strokeStyle = theme.accent;
    context.lineWidth = 3;
    context.beginPath();
    context.roundRect(left - 4, top - 4, width + 8, height + 8, 6);
    context.stroke();
  }
}

/** Names and charges of MEDs and EVs: inside the body if they fit, else above it. */
function drawCharges(context, view, episode, theme) {
  const evs = episode.meta.numMeds + episode.meta.numEvs;
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (let slot = 0; slot < evs; slot += 1) {
    if (episode.present[slot] < 0) continue;
    const body = bodyOf(view, episode, slot);
    if (isInView(view, body) && body.width >= LEAST_PX) drawCharge(context, view, body, episode, theme, slot);
  }
}

function drawCharge(context, view, { left, top, width, height }, episode, theme, slot) {
  const charge = Math.round(100 * episode.soc(slot, episode.frame));
  const pane = Math.min(0.14 * height, 0.1 * width);
  const size = Math.min(13, Math.round(0.8 * height));
  context.font = `${size}px system-ui, sans-serif`;
  context.fillStyle = paint(episode, theme, slot).text;
  for (const text of [`${episode.nameAt(slot, episode.frame)}: ${charge} %`, `${charge} %`]) {
    if (size < 8 || context.measureText(text).width > width - 3 * pane - 2) continue;
    context.fillText(text, left + (width - 2 * pane) / 2, top + height / 2 + 0.5);
    return;
  }
  const [text, x, y] = [`${charge} %`, left + width / 2, Math.max(top - 7, view.top + 6)];
  context.font = "11px system-ui, sans-serif";
  context.fillStyle = theme.asphalt; // lines and other vehicles end at the text
  const half = context.measureText(text).width / 2 + 1;
  context.fillRect(x - half, y - 6, 2 * half, 11);
  context.fillStyle = theme.ink;
  context.fillText(text, x, y);
}
