const $ = (id) => document.getElementById(id);
const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const DRAG_PX = 4;
const TELL_MS = 80;
const SAY_MS = 5000;
const GLIDE_MS = 300;
const STOP_M = 0.05; // too little to be seen
const JUMP_M = 20; // more than the pointer drags between two pictures
const MOST_M_PER_S = 60; // faster than any vehicle
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

/** The page: views, charts and panels on one clock. */
class Player {
  constructor(data, episodes) {
    this.episodes = episodes;
    this.theme = new Theme(data.socScale);
    this.theme.changed = () => this.resize();
    this.clock = new Clock(episodes[0].seconds, (seconds) => this._show(seconds));
    this.camera = { mode: "auto", x: 0 };
    this.gaze = {}; // where all views look; `_eased` keeps it
    this.zoom = 0;
    this._told = -Infinity;
    this._said = -Infinity;
    this.selected = null; // {which, track}
    this.views = episodes.map((episode, which) => this._makeView(episode, which));
    const seek = (seconds) => this.seek(seconds);
    this.charts = episodes[0].meta.charts.map((_, i) => new Chart(i, episodes, this.theme, seek));
    $("charts").append(...this.charts.map(({ root }) => root));
    this.dispatch = episodes.map((episode, which) => new DispatchPanel(episode, which, this));
    $("dispatch-panel").append(...this.dispatch.map(({ root }) => root));
    this.vehicle = new VehiclePanel($("vehicle-panel"), this.theme, this);
    this.ways = episodes.map((episode) => new Ways(episode, this.theme, this));
    this.ways.forEach(({ root }, which) => {
      if (episodes.length > 1) $("ways").append(element("h3", { textContent: episodes[which].meta.policy }));
      $("ways").append(root);
    });
    this.events = new EventLine(episodes, this);
    $("broken-down").hidden = !this.events.of("broken").length;
    this._fillVehicles();
    this._fillMarks();
    this._wire();
    this.resize();
    window.addEventListener("resize", () => this.resize());
    if (data.follow.track !== undefined) this.select(0, episodes[0].tracks[data.follow.track]);
    this.setCamera(data.follow.mode, data.follow.x);
    this.seek(data.start);
    fillStory(data, episodes);
    this.address = new Address(this);
    this.address.read();
  }

  play() {
    this._told = -Infinity;
    this.clock.play();
  }

  pause() {
    this.clock.pause();
  }

  seek(seconds) {
    this.clock.seek(seconds);
  }

  setSpeed(speed) {
    this.clock.speed = speed;
    $("speed").value = String(speed);
  }

  setZoom(zoom) {
    this.zoom = Math.min(Math.max(zoom, -2), 2);
    $("zoom").value = String(this.zoom);
    this.clock.wake();
  }

  /** Sets what colours mean, by a name of `COLOURINGS`. */
  setColouring(name) {
    this.theme.colouring = name;
    $("colour").value = name;
    $("scale").textContent = COLOURINGS[name].words;
    $("legend").classList.toggle("scaled", name !== "charge"); // then gas vehicles are not gray
    this.clock.wake();
  }

  /** `auto`, `selected`, or `free` at x metres. */
  setCamera(mode, x = this.views[0].road.center ?? 0) {
    this.camera = { mode, x };
    $("camera").value = mode;
    this.clock.wake();
  }

  /** Selects a track of an episode; null for none. */
  select(which, track) {
    this.selected = track ? { which, track } : null;
    $("vehicle").value = track && track.kind !== KIND.GAS ? `${which}:${track.index}` : "";
    this.vehicle.show(track ? this.episodes[which] : null, track);
    $("announcer").textContent = track ? `${track.name} selected` : "nothing selected";
    if (!track && this.camera.mode === "selected") this.setCamera("auto");
    this.clock.wake();
  }

  /** The next vehicle of a kind on the road, along it; `direction` -1: the one behind. */
  selectNext(kind, direction) {
    const which = this.selected?.which ?? 0;
    const episode = this.episodes[which];
    const there = [];
    episode.look(this.clock.seconds); // what is drawn may be older
    episode.present.forEach((index, slot) => {
      if (index >= 0 && episode.kindOf(slot) === kind) there.push([episode.x[slot], index]);
    });
    if (!there.length) return;
    there.sort((a, b) => a[0] - b[0]);
    const now = there.findIndex(([, index]) => index === this.selected?.track.index);
    const next = now < 0 && direction < 0 ? there.length - 1 : (now + direction + there.length) % there.length;
    this.select(which, episode.tracks[there[next][1]]);
    this.setCamera("selected");
  }

  resize() {
    const roads = this.views.map(({ road }) => road);
    for (const each of [...roads, ...this.charts, ...this.dispatch, ...this.ways, this.vehicle]) each.resize();
    this.clock.wake();
  }

  _show(seconds) {
    this._aim(seconds);
    this.views.forEach(({ road, line }, which) => {
      road.draw(seconds, this.selected?.which === which ? this.selected.track : null);
      this._count(this.episodes[which], line);
    });
    const now = performance.now();
    if (this.clock.playing && now - this._told < TELL_MS) return;
    this._told = now;
    this._tell(seconds);
  }

  /** Numbers, charts and controls; while the clock runs they need not keep up with the picture. */
  _tell(seconds) {
    for (const chart of this.charts) chart.show(seconds);
    for (const panel of this.dispatch) panel.update(seconds);
    for (const way of this.ways) way.moveTo(seconds);
    this.events.update(seconds);
    this._announce();
    this.vehicle.update(seconds);
    $("scrub").value = String(seconds);
    $("scrub").setAttribute("aria-valuetext", clockText(seconds));
    $("time").value = `${clockText(seconds, 2)} / ${clockText(this.clock.end)}`;
    if (!this.clock.playing) this.address?.keep(seconds);
    const label = this.clock.playing ? "Pause" : "Play";
    if ($("play").textContent !== label) $("play").textContent = label;
    $("play").classList.toggle("playing", this.clock.playing);
  }

  /** Tells screen readers the counters, at most once in 5 s while the clock runs. */
  _announce() {
    const now = performance.now();
    if (!this.clock.playing || now - this._said < SAY_MS) return;
    this._said = now;
    $("announcer").textContent = `${clockText(this.clock.seconds)}: ${this.views[0].line.text.textContent}`;
  }

  /** Points all views at one stretch of the road: at a followed vehicle, a place, or the busiest MED. */
  _aim(seconds) {
    const { mode } = this.camera;
    let x = mode === "free" ? this.camera.x : this.episodes[0].busiest(seconds);
    const { lanes, laneWidth } = this.episodes[0].meta.road;
    let y = 0.5 * (lanes - 1) * laneWidth;
    if (mode === "selected" && this.selected) {
      const { which, track } = this.selected;
      x = this.episodes[which].place(track, seconds);
      y = this.episodes[which].y[track.slot];
    }
    const center = this._eased(x, seconds);
    for (const { road } of this.views) road.aim(center, this.zoom, y);
    if (this.gaze.behind !== 0) this.clock.wake();
  }

  /** Where the camera points: on its vehicle without delay, but it glides to another vehicle or place. */
  _eased(wanted, seconds) {
    const { camera: { mode }, gaze } = this;
    const now = performance.now();
    const target = mode === "selected" ? this.selected?.track : mode;
    const moved = mode === "free" ? 0 : MOST_M_PER_S * Math.abs(seconds - gaze.seconds);
    const jumps = target !== gaze.target || Math.abs(wanted - gaze.aimed) > JUMP_M + moved;
    gaze.behind *= Math.exp((gaze.drawn - now) / GLIDE_MS);
    if (jumps) gaze.behind += gaze.aimed - wanted;
    if (STILL.matches || !(Math.abs(gaze.behind) > STOP_M)) gaze.behind = 0; // nor before the first picture
    Object.assign(gaze, { target, seconds, aimed: wanted, drawn: now });
    return wanted + gaze.behind;
  }

  /** The counters over a view, once a physics tick. */
  _count(episode, line) {
    if (line.frame === episode.frame) return;
    line.frame = episode.frame;
    const { numMeds, numEvs, fleet } = episode.meta;
    let evs = 0;
    for (let slot = numMeds; slot < numMeds + numEvs; slot += 1) evs += episode.present[slot] >= 0;
    const booked = episode.booked(episode.frame);
    const charging = booked.filter((one) => one.charging).length;
    const sent = episode.tables.sent;
    let meds = 0;
    for (let i = 0; i < episode.decided(episode.frame); i += 1) meds += sent.at(0, i) > 0;
    const out = episode.ranOut.filter(({ frame }) => frame <= episode.frame).length;
    line.text.textContent = `MEDs sent ${meds}, fleet ${fleet}  ·  EVs ${evs}  ·  charging ${charging}` +
      `  ·  booked ${booked.length - charging}  ·  ran out\u00a0${out}`;
  }

  _makeView(episode, which) {
    const text = element("span");
    const name = element("span", { className: "name", textContent: episode.meta.policy });
    if (this.episodes.length > 1) name.prepend(keyOf(which));
    const canvas = picture(`The highway under ${episode.meta.policy}: all of it, and the camera's stretch`);
    const line = element("div", { className: "view-line" }, [name, text]);
    $("views").append(element("div", { className: "view" }, [line, canvas]));
    const road = new RoadView(canvas, episode, this.theme, this.episodes.length > 1);
    new Pointer(canvas, road, which, this);
    return { road, line: { text, frame: -1 } };
  }

  _fillVehicles() {
    this.episodes.forEach(({ tracks, meta }, which) => {
      const time = (frame) => clockText(frame * meta.tickSeconds);
      for (const kind of [KIND.MED, KIND.EV]) {
        const options = tracks.filter((track) => track.kind === kind).map(({ index, name, first, last }) =>
          element("option", { value: `${which}:${index}`, textContent: `${name} (${time(first)}–${time(last)})` }));
        const several = this.episodes.length > 1 ? `, ${meta.policy}` : "";
        if (options.length) $("vehicle").append(element("optgroup", { label: `${KIND_NAMES[kind]}s${several}` }, options));
      }
    });
  }

  _fillMarks() {
    for (const event of this.events.of("sent")) {
      const mark = element("i", { className: LINE_COLORS[event.which] });
      mark.style.left = `${(100 * event.seconds) / this.clock.end}%`;
      mark.title = `${clockText(event.seconds)} ${event.text}: go there`;
      mark.addEventListener("click", () => this.events.go(event));
      $("marks").append(mark);
    }
  }
}
