Object.assign(Player.prototype, {
  /** Controls and keys. */
  _wire() {
    $("scrub").max = String(this.clock.end);
    $("scrub").addEventListener("input", (event) => this.seek(Number(event.target.value)));
    $("play").addEventListener("click", () => this._toggle());
    $("back").addEventListener("click", () => this.seek(this.clock.seconds - 1));
    $("forward").addEventListener("click", () => this.seek(this.clock.seconds + 1));
    $("speed").addEventListener("change", (event) => this.setSpeed(Number(event.target.value)));
    $("colour").addEventListener("change", (event) => this.setColouring(event.target.value));
    $("zoom").addEventListener("input", (event) => this.setZoom(Number(event.target.value)));
    $("camera").addEventListener("change", (event) => this.setCamera(event.target.value));
    $("vehicle").addEventListener("change", (event) => this._choose(event.target.value));
    $("help-button").addEventListener("click", () => $("help").showModal());
    document.addEventListener("keydown", (event) => this._key(event));
  },

  _toggle() {
    if (this.clock.playing) this.pause();
    else this.play();
  },

  /** A vehicle from the list; if it is not on the road now, the clock goes to when it is. */
  _choose(value) {
    if (!value) {
      this.select(0, null);
      return;
    }
    const [which, index] = value.split(":").map(Number);
    const episode = this.episodes[which];
    const track = episode.tracks[index];
    this.select(which, track);
    this.setCamera("selected");
    const frame = episode.frameAt(this.clock.seconds);
    if (frame < track.first || frame > track.last) this.seek(track.first * episode.meta.tickSeconds);
  },

  _key(event) {
    const { target } = event;
    if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
    const tag = target.tagName;
    if (tag === "SELECT") return; // its own keys choose an entry
    if (tag === "BUTTON" && (event.key === " " || event.key === "Enter")) return;
    const own = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End"];
    if (tag === "INPUT" && target.id !== "scrub" && own.includes(event.key)) return;
    const action = this._actions(event)[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  },

  /** What each key does. */
  _actions({ shiftKey }) {
    const { clock } = this;
    const tick = this.episodes[0].meta.tickSeconds;
    const back = shiftKey ? -1 : 1;
    const faster = (steps) => {
      const now = SPEEDS.indexOf(clock.speed) + steps;
      this.setSpeed(SPEEDS[Math.min(Math.max(now, 0), SPEEDS.length - 1)]);
    };
    const toTick = (steps) => {
      const frame = Math.round(clock.seconds / tick) + steps;
      this.pause();
      this.seek(frame * tick);
    };
    const pan = (share) => {
      const { road } = this.views[0];
      this.setCamera("free", road.center + share * road.camera.span);
    };
    return {
      " ": () => this._toggle(),
      ArrowLeft: () => this.seek(clock.seconds - (shiftKey ? 10 : 1)),
      ArrowRight: () => this.seek(clock.seconds + (shiftKey ? 10 : 1)),
      ArrowUp: () => faster(1),
      ArrowDown: () => faster(-1),
      ",": () => toTick(-1),
      ".": () => toTick(1),
      Home: () => this.seek(0),
      End: () => this.seek(clock.end),
      n: () => this.events.step(clock.seconds, back),
      d: () => this.events.step(clock.seconds, back, this.events.of("sent")),
      m: () => this.selectNext(KIND.MED, back),
      e: () => this.selectNext(KIND.EV, back),
      g: () => this.selectNext(KIND.GAS, back),
      f: () => this.selected && this.setCamera("selected"),
      a: () => this.setCamera("auto"),
      "[": () => pan(-0.25),
      "]": () => pan(0.25),
      "+": () => this.setZoom(this.zoom + 0.25),
      "=": () => this.setZoom(this.zoom + 0.25),
      "-": () => this.setZoom(this.zoom - 0.25),
      Escape: () => this.select(0, null),
      "?": () => $("help").showModal(),
    };
  },
});

/** Unpacks the recordings that the page holds and starts the player. */
async function start() {
  const data = JSON.parse($("meta").textContent);
  const episodes = await Promise.all(
    data.episodes.map(async (meta, i) => new Episode(meta, await unpack(meta.arrays, $(`data-${i}`).textContent))),
  );
  window.medjaxPlayer = new Player(data, episodes); // for the console, and for tests
}

start().catch((error) => {
  $("failure").hidden = false;
  $("failure").textContent = `This browser cannot show the episode (${error.message}). Please use a recent one.`;
  throw error;
});
