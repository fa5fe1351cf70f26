const STANDS_S = 5;
const LATE_M = 15; // most between a vehicle's last picture and the exit lane that it took

/** Events of an episode: `[{seconds, text, track, x, kind}]`, of a vehicle or at a place. */
function happenings(episode) {
  const { meta, frames, tables, tracks } = episode;
  const found = [];
  const note = (frame, kind, text, track, x) => found.push({ seconds: frame * meta.tickSeconds, kind, text, track, x });
  for (let i = 0; i < tables.sent.times; i += 1) {
    const ramp = tables.sent.at(0, i);
    const frame = Math.min(i * meta.ticksPerDecision, frames - 1);
    if (ramp > 0) note(frame, "sent", `MED sent from ramp ${ramp}`, undefined, meta.road.ramps[ramp - 1]);
  }
  for (const track of tracks) {
    if (track.kind === KIND.EV) noteFirstCharge(episode, track, note);
    if (track.kind === KIND.MED) {
      for (const { frame, text } of episode.orders(track)) note(frame, "told", `${track.name} ordered: ${text}`, track);
      noteLeaving(episode, track, note);
    }
    noteStanding(episode, track, note);
  }
  for (const [slot, first, after] of meta.brokenDown) {
    const [track, later] = [first, after].map((frame) => tracks[episode.trackAt[slot * frames + frame]]);
    note(first, "broken", `${track.name} breaks down`, track);
    if (after < frames && later === track) note(after, "broken", `${track.name} drives on`, track);
  }
  for (const { frame, slot, track, name } of episode.ranOut) note(frame, "out", `${name} ran out`, track, tables.x.at(slot, frame));
  return found;
}

function noteFirstCharge(episode, track, note) {
  for (let frame = track.first; frame <= track.last; frame += 1) {
    const booking = episode.booking(track.slot, frame);
    if (!booking?.charging) continue;
    note(frame, "charge", `${track.name} is charged by ${episode.nameAt(booking.med, frame)}`, track);
    return;
  }
}

/** When a MED heads for its exit, for which one if it got there, and for which of several depots. */
function noteLeaving(episode, track, note) {
  const { meta, tables, frames } = episode;
  for (let frame = track.first + 1; frame <= track.last; frame += 1) {
    if (episode.status(track.slot, frame) !== meta.leaving || !episode.inService(track.slot, frame - 1)) continue;
    const { exits, exitLane } = meta.road;
    const end = tables.x.at(track.slot, track.last);
    const taken = (x) => end <= x && end > x - exitLane - LATE_M;
    const exit = track.last + 1 < frames ? exits.findIndex(taken) : -1;
    const depot = meta.numDepots > 1 ? ` and depot ${tables.medDepot.at(track.slot, track.last) + 1}` : "";
    note(frame, "leaves", `${track.name} heads for ${exit < 0 ? "its exit" : `exit ${exit + 1}`}${depot}`, track);
    return;
  }
}

/** Vehicles that stand on the main road for a while. */
function noteStanding(episode, track, note) {
  const { tables, meta } = episode;
  const least = Math.round(STANDS_S / meta.tickSeconds);
  let since = 0;
  for (let frame = track.first; frame <= track.last; frame += 1) {
    const stands = tables.lane.at(track.slot, frame) < meta.road.lanes && tables.speed.at(track.slot, frame) < CRAWL_M_PER_S;
    since = stands ? since + 1 : 0;
    if (since === least) note(frame, "stands", `${track.name} stands still`, track);
  }
}

/** The list of events of all episodes, which follows the clock. */
class EventLine {
  constructor(episodes, player) {
    Object.assign(this, { player, now: -1 });
    this.root = $("event-list");
    this.events = episodes
      .flatMap((episode, which) => happenings(episode).map((event) => ({ ...event, which })))
      .sort((a, b) => a.seconds - b.seconds);
    this.items = this.events.map((event) => {
      const text = `${clockText(event.seconds)} ${event.text}`;
      const item = listButton(text, () => this.go(event), { className: event.kind });
      const { policy } = episodes[event.which].meta;
      if (episodes.length > 1) { // a colour to see, words for screen readers
        const heard = element("span", { className: "unseen", textContent: `${policy}, ` });
        item.firstChild.title = policy;
        item.firstChild.prepend(keyOf(event.which), heard);
      }
      return item;
    });
    const none = "No MED is sent, no vehicle stops, none is charged or runs out.";
    if (!this.items.length) this.items.push(element("li", { textContent: none }));
    this.root.append(...this.items);
  }

  /** Events of one kind, of all episodes. */
  of(kind) {
    return this.events.filter((event) => event.kind === kind);
  }

  /** Moves clock and camera to an event. */
  go({ seconds, which, track, x }) {
    this.player.seek(seconds);
    if (track && x === undefined) {
      this.player.select(which, track);
      this.player.setCamera("selected");
    } else this.player.setCamera("free", x);
  }

  /** The next event after the clock, or with -1 the one before, among all or some. */
  step(seconds, direction, events = this.events) {
    const found = direction > 0
      ? events.find((event) => event.seconds > seconds + 1e-6)
      : events.findLast((event) => event.seconds < seconds - 1e-6);
    if (found) this.go(found);
  }

  update(seconds) {
    const after = this.events.findIndex((event) => event.seconds > seconds + 1e-6);
    const now = (after < 0 ? this.events.length : after) - 1;
    if (now === this.now) return;
    this.items[this.now]?.removeAttribute("aria-current");
    this.now = now;
    const item = this.items[Math.max(now, 0)];
    if (now >= 0) item.setAttribute("aria-current", "true");
    if (!this.root.matches(":hover, :focus-within")) { // do not scroll under a reader
      this.root.scrollTop = item.offsetTop - this.root.clientHeight + item.offsetHeight;
    }
  }
}
