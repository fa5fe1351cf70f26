/** The time of all views; it advances by real time, however often the page is drawn. */
class Clock {
  constructor(end, onTick) {
    Object.assign(this, { end, onTick, seconds: 0, speed: 1, playing: false });
    this.framesPerSecond = 0;
    this._last = null;
    this._waiting = false;
  }

  play() {
    if (this.seconds >= this.end) this.seconds = 0;
    this.playing = true;
    this._last = null;
    this.wake();
  }

  pause() {
    this.playing = false;
    this.wake();
  }

  seek(seconds) {
    this.seconds = Math.min(Math.max(seconds, 0), this.end);
    this.wake();
  }

  /** Draws at the next opportunity. */
  wake() {
    if (this._waiting) return;
    this._waiting = true;
    requestAnimationFrame((now) => this._frame(now));
  }

  _frame(now) {
    this._waiting = false;
    if (this.playing) {
      // A page in the background gets no frames; its time stands still.
      const passed = this._last === null ? 0 : Math.min((now - this._last) / 1000, 0.5);
      if (passed > 0) this.framesPerSecond = 0.95 * (this.framesPerSecond || 1 / passed) + 0.05 / passed;
      this._last = now;
      this.seconds = Math.min(this.seconds + passed * this.speed, this.end);
      if (this.seconds >= this.end) this.playing = false;
    }
    this.onTick(this.seconds);
    if (this.playing) this.wake();
  }
}
