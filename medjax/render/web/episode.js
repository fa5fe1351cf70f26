const KIND = { MED: 0, EV: 1, GAS: 2 };
const KIND_NAMES = ["MED", "EV", "gas vehicle"];

/** A MED's order in words. */
function orderText(speed, lane, accepts) {
  return `${speed.toFixed(0)} m/s in lane ${lane + 1}, ${accepts ? "accepts EVs" : "refuses EVs"}`;
}

/** One vehicle's stay on the road. */
class Track {
  constructor(index, [slot, first, last, number, kind], episode) {
    Object.assign(this, { index, slot, first, last, number });
    this.body = episode.meta.kinds[kind];
    this.kind = episode.kindOf(slot);
    this.name = `${this.kind === KIND.GAS ? "gas" : KIND_NAMES[this.kind]} ${number}`;
  }
}

/** A recording, at any time. */
class Episode {
  constructor(meta, tables) {
    this.meta = meta;
    this.tables = tables;
    this.frames = tables.x.times;
    this.decisions = tables.action.times;
    this.decisionSeconds = meta.tickSeconds * meta.ticksPerDecision;
    this.seconds = (this.frames - 1) * meta.tickSeconds;
    this.tracks = meta.tracks.map((fields, index) => new Track(index, fields, this));
    this.trackAt = new Int32Array(meta.numVehicles * this.frames).fill(-1);
    for (const { slot, first, last, index } of this.tracks) {
      this.trackAt.fill(index, slot * this.frames + first, slot * this.frames + last + 1);
    }
    this.ranOut = meta.ranOut.map(([slot, frame, gone, x]) => {
      const track = this.tracks[this.trackAt[slot * this.frames + gone - 1]];
      return { slot, frame, gone, x, track, name: track?.name ?? "EV" };
    });
    // Set by `look`, by slot; `looked` is its time, s.
    this.x = new Float64Array(meta.numVehicles);
    this.y = new Float64Array(meta.numVehicles);
    this.tilt = new Float64Array(meta.numVehicles); // m to the right for each m along, of its heading
    this.present = new Int32Array(meta.numVehicles);
    this.look(0);
  }

  kindOf(slot) {
    if (slot < this.meta.numMeds) return KIND.MED;
    return slot < this.meta.numMeds + this.meta.numEvs ? KIND.EV : KIND.GAS;
  }

  /** The last physics tick at a time. */
  frameAt(seconds) {
    const frame = Math.floor(seconds / this.meta.tickSeconds + 1e-6);
    return Math.min(Math.max(frame, 0), this.frames - 1);
  }

  /** Decisions that have been taken before a frame. */
  decided(frame) {
    return Math.min(Math.ceil(frame / this.meta.ticksPerDecision), this.decisions);
  }

  /** Finds all vehicles, interpolated linearly between two ticks. `present` holds tracks, -1 for none. */
  look(seconds) {
    if (seconds === this.looked) return;
    const { frames, tables, meta, trackAt } = this;
    const frame = this.frameAt(seconds);
    const share = frame + 1 < frames ? Math.max(0, seconds / meta.tickSeconds - frame) : 0;
    for (let slot = 0; slot < meta.numVehicles; slot += 1) {
      const here = slot * frames + frame;
      const track = trackAt[here];
      this.present[slot] = track;
      if (track < 0) continue;
      const x = tables.x.steps[here] * tables.x.step;
      const y = tables.y.steps[here] * tables.y.step;
      const stays = frame + 1 < frames && trackAt[here + 1] === track;
      const ahead = stays
        ? tables.x.steps[here + 1] * tables.x.step - x
        : tables.speed.steps[here] * tables.speed.step * meta.tickSeconds;
      const aside = stays ? tables.y.steps[here + 1] * tables.y.step - y : 0;
      this.tilt[slot] = aside / Math.max(ahead, meta.tickSeconds); // a crawl does not turn a vehicle
      this.x[slot] = x + share * ahead;
      this.y[slot] = y + share * aside;
    }
    Object.assign(this, { looked: seconds, frame });
  }

  /** Position of the busiest MED of all episodes on the page, m; it jumps to the next MED instead of racing there. */
  busiest(seconds) {
    const frame = this.frameAt(seconds);
    const now = this.tables.camera.at(0, frame);
    const then = this.tables.camera.at(0, Math.min(frame + 1, this.frames - 1));
    const share = seconds / this.meta.tickSeconds - frame;
    return Math.abs(then - now) < 100 * this.meta.tickSeconds ? now + share * (then - now) : now;
  }

  /** Position of a track, m: its first before it enters, its last after it leaves. */
  place(track, seconds) {
    const frame = this.frameAt(seconds);
    if (this.trackAt[track.slot * this.frames + frame] === track.index) {
      this.look(seconds);
      return this.x[track.slot];
    }
    return this.tables.x.at(track.slot, frame < track.first ? track.first : track.last);
  }

  /** Position of a track at a tick of its stay or between two, `[x, y]` m. */
  placeAt({ slot, last }, tick) {
    const frame = Math.floor(tick);
    return [this.tables.x, this.tables.y].map((table) => {
      const [now, then] = [table.at(slot, frame), table.at(slot, Math.min(frame + 1, last))];
      return now + (tick - frame) * (then - now);
    });
  }

  /** Booking of an EV's slot at a frame: the MED's slot, the panel, and whether it charges; null for none. */
  booking(slot, frame) {
    const ev = slot - this.meta.numMeds;
    const med = this.tables.evMed.at(ev, frame);
    if (med < 0) return null;
    const panel = this.tables.evPanel.at(ev, frame);
    return { med, panel, charging: this.tables.evCharging.at(ev, frame) === 1 };
  }

  /** State of charge of a MED's or EV's slot. */
  soc(slot, frame) {
    const { evSoc, medSoc } = this.tables;
    const { numMeds } = this.meta;
    return slot < numMeds ? medSoc.at(slot, frame) : evSoc.at(slot - numMeds, frame);
  }

  status(slot, frame) {
    return this.tables.medStatus.at(slot, frame);
  }

  inService(slot, frame) {
    return this.status(slot, frame) === this.meta.inService;
  }

  /** The order of the MED in a slot. */
  told(slot, frame) {
    const { medSpeedTold, medLaneTold, medAccepts } = this.tables;
    return orderText(medSpeedTold.at(slot, frame), medLaneTold.at(slot, frame), medAccepts.at(slot, frame));
  }

  /** New orders of a MED in service, `[{frame, text}]`; the fleet's default order is not new. */
  orders(track) {
    const { speed, lane } = this.meta.fleetOrder;
    const { step } = this.tables.medSpeedTold;
    let before = orderText(Math.round(speed / step) * step, lane, true);
    const found = [];
    for (let frame = track.first; frame <= track.last; frame += 1) {
      if (!this.inService(track.slot, frame)) continue;
      const text = this.told(track.slot, frame);
      if (text !== before) found.push({ frame, text });
      before = text;
    }
    return found;
  }

  /** The slots of MEDs on the road, `[{med, panel, x, y, link}]`: free ones in service, and those booked by `link`. */
  slots() {
    const { meta, frame, present } = this;
    const links = new Map(this.booked(frame).map((link) => [8 * link.med + link.panel, link]));
    const right = (meta.road.lanes - 0.5) * meta.road.laneWidth;
    const found = [];
    for (let med = 0; med < meta.numMeds; med += 1) {
      if (present[med] < 0) continue;
      const serves = this.inService(med, frame);
      meta.slots.forEach(([ahead, aside], panel) => {
        const link = links.get(8 * med + panel);
        const [x, y] = [this.x[med] + ahead, this.y[med] + aside];
        const open = serves && y >= -meta.road.laneWidth / 2 && y <= right;
        if (link || open) found.push({ med, panel, x, y, link });
      });
    }
    return found;
  }

  /** Whether an incident makes the gas vehicle in a slot stand, or brake to stand there. */
  brokenDown(slot, frame) {
    return this.meta.brokenDown.some(([whose, first, after]) => whose === slot && first <= frame && frame < after);
  }

  /** Name of the vehicle in a slot. */
  nameAt(slot, frame) {
    const index = this.trackAt[slot * this.frames + frame];
    return index < 0 ? `${KIND_NAMES[this.kindOf(slot)]}` : this.tracks[index].name;
  }

  /** Slots of EVs with a booking, on the road. */
  booked(frame) {
    const found = [];
    const { numMeds, numEvs } = this.meta;
    for (let slot = numMeds; slot < numMeds + numEvs; slot += 1) {
      if (this.trackAt[slot * this.frames + frame] < 0) continue;
      const booking = this.booking(slot, frame);
      if (booking) found.push({ slot, ...booking });
    }
    return found;
  }

  /** EVs that have run out by now: each where it is, or where it left the road. */
  *crosses() {
    for (const { slot, frame, gone, x, name } of this.ranOut) {
      if (frame <= this.frame) yield { name, frame, x: gone <= this.frame ? x : this.x[slot] };
    }
  }

  /** Whether a track ends without energy. */
  stranded(track) {
    return this.ranOut.some(({ slot, gone }) => slot === track.slot && gone === track.last + 1);
  }
}
