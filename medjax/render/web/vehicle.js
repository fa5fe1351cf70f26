/** What happened to a vehicle: `[{seconds, text}]` in the order of time. */
function eventsOf(episode, track) {
  const events = [];
  const { tickSeconds, panels, numMeds } = episode.meta;
  const note = (frame, text) => events.push({ seconds: frame * tickSeconds, text });
  note(track.first, track.first === 0 ? "on the road at the start" : "enters");
  if (track.kind === KIND.EV) {
    let before = null;
    for (let frame = track.first; frame <= track.last; frame += 1) {
      const now = episode.booking(track.slot, frame);
      if (now && (!before || now.med !== before.med || now.panel !== before.panel)) {
        note(frame, `books ${episode.nameAt(now.med, frame)}, ${panels[now.panel]} slot`);
      }
      if (now?.charging && !before?.charging) note(frame, "begins to charge");
      if (before?.charging && !now?.charging) note(frame, "stops charging");
      if (before && !now) note(frame, "booking ends");
      before = now;
    }
  }
  if (track.kind === KIND.MED) {
    let before = -1;
    for (let frame = track.first; frame <= track.last; frame += 1) {
      const now = episode.status(track.slot, frame);
      if (now !== before && before >= 0) note(frame, episode.meta.statuses[now]);
      before = now;
    }
    for (const { frame, text } of episode.orders(track)) note(frame, `ordered: ${text}`);
    for (let ev = 0; ev < episode.meta.numEvs; ev += 1) {
      for (let frame = track.first + 1; frame <= track.last; frame += 1) {
        const now = episode.booking(numMeds + ev, frame);
        if (now?.med !== track.slot || !now.charging) continue;
        if (episode.booking(numMeds + ev, frame - 1)?.charging) continue;
        note(frame, `charges ${episode.nameAt(numMeds + ev, frame)} (${panels[now.panel]})`);
      }
    }
  }
  for (const { track: whose, frame } of episode.ranOut) if (whose === track) note(frame, "runs out of energy");
  if (track.last + 1 < episode.frames) note(track.last + 1, "leaves");
  return events.sort((a, b) => a.seconds - b.seconds);
}

/** Names and values of what a vehicle does at a frame of its stay. */
function factsOf(episode, track, frame) {
  const { tables, meta } = episode;
  const lane = tables.lane.at(track.slot, frame);
  const facts = [
    ["position", `${tables.x.at(track.slot, frame).toFixed(1)} m`],
    ["speed", `${tables.speed.at(track.slot, frame).toFixed(2)} m/s`],
    ["lane", lane === meta.road.lanes ? "acceleration lane" : `${lane + 1} of ${meta.road.lanes} from the left`],
  ];
  if (episode.brokenDown(track.slot, frame)) facts.push(["broken down", "blocks its lane"]);
  if (track.kind === KIND.GAS) return facts;
  const soc = episode.soc(track.slot, frame);
  const kwh = soc * (track.kind === KIND.MED ? meta.medKwh : meta.evKwh);
  facts.push(["charge", `${(100 * soc).toFixed(2)} % (${kwh.toFixed(3)} kWh)`]);
  if (track.kind === KIND.MED) {
    facts.push(["status", meta.statuses[episode.status(track.slot, frame)]]);
    if (episode.inService(track.slot, frame)) facts.push(["order", episode.told(track.slot, frame)]);
    const served = episode.booked(frame).filter(({ med }) => med === track.slot);
    const texts = served.map(({ slot, panel, charging }) =>
      `${episode.nameAt(slot, frame)} ${meta.panels[panel]}${charging ? ", charging" : ""}`);
    facts.push(["slots", texts.join("; ") || "all free"]);
    return facts;
  }
  facts.push(["driver", track.body.name.split(" ")[0]]);
  const booking = episode.booking(track.slot, frame);
  const text = booking && `${episode.nameAt(booking.med, frame)}, ${meta.panels[booking.panel]} slot`;
  facts.push(["booked", text ? `${text}, ${booking.charging ? "charging" : "on its way"}` : "no slot"]);
  return facts;
}

/** The panel of the selected vehicle: its state now, and its history. */
class VehiclePanel {
  constructor(root, theme, player) {
    Object.assign(this, { root, theme, player, plots: [] });
    this.show(null, null);
  }

  /** Shows another vehicle; null for none. */
  show(episode, track) {
    Object.assign(this, { episode, track, frame: -1, plots: [] });
    this.root.classList.toggle("nobody", !track);
    if (!track) {
      this.root.replaceChildren(
        element("h2", { textContent: "No vehicle selected" }),
        element("p", { textContent: "Click one, choose one under Vehicle, or press M, E or G." }),
      );
      return;
    }
    const several = this.player.episodes.length > 1;
    const title = `${track.name}${several ? ` (${episode.meta.policy})` : ""}`;
    this.facts = element("dl", { className: "facts" });
    this.root.replaceChildren(element("h2", { textContent: title }), this.facts);
    const { tables } = episode;
    this._addPlot("Speed (m/s)", (frame) => tables.speed.at(track.slot, frame), 5);
    if (track.kind !== KIND.GAS) this._addPlot("Charge (%)", (frame) => 100 * episode.soc(track.slot, frame), 10);
    this.root.append(element("h3", { textContent: "History" }), this._events());
    this.resize();
  }

  resize() {
    for (const plot of this.plots) plot.resize();
  }

  /** Updates numbers once a physics tick. */
  update(seconds) {
    if (!this.track) return;
    for (const plot of this.plots) plot.moveTo(seconds);
    const { episode, track } = this;
    const frame = episode.frameAt(seconds);
    if (frame === this.frame) return;
    this.frame = frame;
    const time = (tick) => clockText(tick * episode.meta.tickSeconds, 2);
    let facts;
    if (frame < track.first) facts = [["position", `enters at ${time(track.first)}`]];
    else if (frame <= track.last) facts = factsOf(episode, track, frame);
    else facts = [["position", `left${episode.stranded(track) ? ", out of energy," : ""} at ${time(track.last + 1)}`]];
    this.facts.replaceChildren(...facts.flatMap(([name, value]) => [
      element("dt", { textContent: name }),
      element("dd", { textContent: value }),
    ]));
    this.facts.dataset.frame = frame;
  }

  _addPlot(title, valueAt, least) {
    const { first, last, name } = this.track;
    const step = this.episode.meta.tickSeconds;
    const start = first * step;
    const plot = new Plot({
      lines: [{ values: (i) => valueAt(first + i), count: last - first + 1, step, start, color: "first" }],
      start,
      end: Math.max(last, first + 1) * step,
      least,
      theme: this.theme,
      label: `${title} of ${name} over time`,
      onSeek: (seconds) => this.player.seek(seconds),
    });
    this.plots.push(plot);
    this.root.append(element("h3", { textContent: title }), plot.root);
  }

  _events() {
    const items = eventsOf(this.episode, this.track).map(({ seconds, text }) =>
      listButton(`${clockText(seconds, 2)} ${text}`, () => this.player.seek(seconds)));
    return element("ul", { className: "events" }, items);
  }
}
