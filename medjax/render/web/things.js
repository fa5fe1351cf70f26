const REACH_PX = 5; // from the pointer to the thing that it names

/** Mean speeds in cells of `CELL_M` along the road, m/s, NaN in an empty one. */
function cellSpeeds(episode) {
  const cells = Math.ceil(episode.meta.road.length / CELL_M);
  const [sums, counts] = [new Float64Array(cells), new Int32Array(cells)];
  for (let slot = 0; slot < episode.meta.numVehicles; slot += 1) {
    if (episode.present[slot] < 0) continue;
    const cell = Math.min(Math.max(Math.floor(episode.x[slot] / CELL_M), 0), cells - 1);
    sums[cell] += speedOf(episode, slot);
    counts[cell] += 1;
  }
  return sums.map((sum, cell) => sum / counts[cell]);
}

/** Things on the road besides vehicles, topmost first: text, from `from` to `to` m, `deep` m across around `y` m. */
function* things(episode) {
  const { road, tickSeconds } = episode.meta;
  for (const { frame, x, name } of episode.crosses()) {
    const text = `${name} ran out, at ${clockText(frame * tickSeconds)}`;
    yield { text, from: x, to: x, y: road.shoulder, deep: 0 };
  }
  for (const slot of episode.slots()) yield* thingsOfSlot(episode, slot);
  const [beside, deep] = [road.lanes * road.laneWidth, road.laneWidth];
  for (const [i, x] of road.ramps.entries()) {
    yield { text: `ramp ${i + 1}, where vehicles enter`, from: x, to: x + road.mergeLength, y: beside, deep };
  }
  for (const [i, x] of road.exits.entries()) {
    yield { text: `exit ${i + 1}, where vehicles leave`, from: x - road.exitLane, to: x, y: beside, deep };
  }
  for (let lane = 0; lane < road.lanes; lane += 1) {
    yield { text: `lane ${lane + 1} of ${road.lanes}`, from: 0, to: road.length, y: lane * deep, deep };
  }
}

/** A slot of a MED, free or booked; while it charges, the boom between the two. */
function* thingsOfSlot(episode, { med, panel, x, y, link }) {
  const { meta, frame, tracks, present } = episode;
  const { length, width } = meta.slotBody;
  const [whose, where] = [episode.nameAt(med, frame), `${meta.panels[panel]} slot`];
  const ev = link && episode.nameAt(link.slot, frame);
  if (!link?.charging) {
    const text = `${where} of ${whose}, ${ev ? `booked by ${ev}` : "free"}`;
    yield { text, from: x - length, to: x, y, deep: width };
    return;
  }
  const middles = [med, link.slot].map((slot) => episode.x[slot] - tracks[present[slot]].body.length / 2);
  const across = [med, link.slot].map((slot) => episode.y[slot]);
  yield {
    text: `${whose} charges ${ev}, ${where}`,
    from: Math.min(...middles),
    to: Math.max(...middles),
    y: (across[0] + across[1]) / 2,
    deep: Math.abs(across[0] - across[1]),
  };
}

/** The topmost thing at a point of a picture, in words; "" for none. */
function thingAt(view, episode, x, y) {
  for (const { text, from, to, y: across, deep } of things(episode)) {
    const beside = Math.max(view.px(from) - x, x - view.px(to));
    const aside = Math.abs(view.py(across) - y) - (deep / 2) * view.perY;
    if (beside <= REACH_PX && aside <= (deep > 1 ? 0 : REACH_PX)) return text; // thin things are hard to hit
  }
  return "";
}

/** A vehicle in words. */
function vehicleText(episode, track) {
  const speed = `${speedOf(episode, track.slot).toFixed(1)} m/s`;
  const broken = episode.brokenDown(track.slot, episode.frame) ? ", broken down" : "";
  if (track.kind === KIND.GAS) return `${track.name} (${track.body.name}), ${speed}${broken}`;
  const charge = `${Math.round(100 * episode.soc(track.slot, episode.frame))} %`;
  const booking = track.kind === KIND.EV ? episode.booking(track.slot, episode.frame) : null;
  const parts = [track.name, charge, speed];
  if (booking) parts.push(`${booking.charging ? "charged by" : "on its way to"} ${episode.nameAt(booking.med, episode.frame)}`);
  return parts.join(", ");
}

/** Whatever is at a point of a road's picture, in words. */
function whatIsAt(road, x, y) {
  const { episode, strip, camera } = road;
  const part = road.partAt(y);
  const view = part === "strip" ? strip : camera;
  const metres = view.metres(x);
  if (part === "strip" && y < strip.top) {
    const speed = cellSpeeds(episode)[Math.floor(metres / CELL_M)];
    return speed >= 0 ? `mean speed here: ${speed.toFixed(1)} m/s` : "no traffic here";
  }
  const track = part && road.vehicleAt(x, y, REACH_PX);
  if (track) return vehicleText(episode, track);
  const thing = part && thingAt(view, episode, x, y);
  const place = metres >= 0 && metres <= episode.meta.road.length ? `${metres.toFixed(0)} m` : "off the road";
  const said = thing ? `${thing}; ${place}` : place;
  return part === "strip" ? `${said}; click to look there` : said;
}
