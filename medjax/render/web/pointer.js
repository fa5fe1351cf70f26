const WHEEL_ZOOM = 1 / 400; // for a pixel of the wheel

/** The pointer on a view: names and selects things, drags the camera, and zooms. */
class Pointer {
  constructor(canvas, road, which, player) {
    Object.assign(this, { canvas, road, which, player, from: null, touches: new Map(), apart: 0 });
    const on = (name, act, options) => canvas.addEventListener(name, act, options);
    on("pointerdown", (event) => this._down(event));
    on("pointermove", (event) => this._move(event));
    on("pointercancel", (event) => this._forget(event));
    on("pointerup", (event) => this._up(event));
    on("wheel", (event) => this._wheel(event), { passive: false });
  }

  _place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** Distance of two fingers, px. */
  _apart() {
    const [a, b] = [...this.touches.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  }

  _down(event) {
    const [x, y] = this._place(event);
    const { road } = this;
    this.touches.set(event.pointerId, [x, y]);
    this.canvas.setPointerCapture(event.pointerId);
    if (this.touches.size === 2) this.apart = this._apart();
    this.from = this.touches.size > 1 ? null : { x, center: road.center, part: road.partAt(y), moved: false };
  }

  _move(event) {
    const [x, y] = this._place(event);
    const { road, player, from } = this;
    if (this.touches.has(event.pointerId)) this.touches.set(event.pointerId, [x, y]);
    if (this.touches.size === 2) {
      const apart = this._apart();
      if (apart > 0 && this.apart > 0) player.setZoom(player.zoom + Math.log2(apart / this.apart));
      this.apart = apart;
    } else if (from) {
      from.moved ||= Math.abs(x - from.x) > DRAG_PX;
      if (!from.moved) return;
      if (from.part === "strip") player.setCamera("free", road.strip.metres(x));
      else if (from.part) player.setCamera("free", from.center - (x - from.x) / road.camera.perX);
    } else this.canvas.title = whatIsAt(road, x, y);
  }

  _forget(event) {
    this.touches.delete(event.pointerId);
    this.from = null;
  }

  _up(event) {
    const click = this.from && !this.from.moved;
    this._forget(event);
    if (!click) return;
    const [x, y] = this._place(event);
    const { road, player, which } = this;
    const track = road.vehicleAt(x, y);
    if (track) player.select(which, track);
    else if (road.partAt(y) === "strip") player.setCamera("free", road.strip.metres(x));
    else player.select(which, null);
  }

  /** Zooms; unless a vehicle is followed, the place under the pointer stays there. */
  _wheel(event) {
    const [x, y] = this._place(event);
    const { road, player } = this;
    if (road.partAt(y) !== "camera") return;
    event.preventDefault();
    const before = road.camera.metres(x);
    const share = (x - road.camera.left) / road.camera.width;
    player.setZoom(player.zoom - event.deltaY * WHEEL_ZOOM);
    if (player.camera.mode !== "free") return;
    const span = Math.min(road.span * 2 ** -player.zoom, road.episode.meta.road.length);
    player.setCamera("free", before + (0.5 - share) * span);
  }
}
