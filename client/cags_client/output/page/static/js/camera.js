// Where the visitor is. Poses are T_world_camera with +X right, +Y down, +Z forward; quaternions are wxyz.

const TAP_S = 1 / 60;
const add = (a, b, s = 1) => [a[0] + b[0] * s, a[1] + b[1] * s, a[2] + b[2] * s];
const sub = (a, b) => add(a, b, -1);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => {
  const n = Math.hypot(...a) || 1;
  return [a[0] / n, a[1] / n, a[2] / n];
};
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

const MAX_PITCH = 1.5;

/** Columns right, down, forward of the rotation matrix of a quaternion. */
export function axesOf([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

function quaternionOf([r, d, f]) {
  const trace = r[0] + d[1] + f[2];
  if (trace > 0) {
    const s = 2 * Math.sqrt(trace + 1);
    return [s / 4, (d[2] - f[1]) / s, (f[0] - r[2]) / s, (r[1] - d[0]) / s];
  }
  if (r[0] > d[1] && r[0] > f[2]) {
    const s = 2 * Math.sqrt(1 + r[0] - d[1] - f[2]);
    return [(d[2] - f[1]) / s, s / 4, (d[0] + r[1]) / s, (f[0] + r[2]) / s];
  }
  if (d[1] > f[2]) {
    const s = 2 * Math.sqrt(1 + d[1] - r[0] - f[2]);
    return [(f[0] - r[2]) / s, (d[0] + r[1]) / s, s / 4, (f[1] + d[2]) / s];
  }
  const s = 2 * Math.sqrt(1 + f[2] - r[0] - d[1]);
  return [(r[1] - d[0]) / s, (f[0] + r[2]) / s, (f[1] + d[2]) / s, s / 4];
}

/** A camera of yaw and pitch about the scene's up, that orbits a target or flies; it never rolls. */
export class Camera {
  #followed = null; // a pose that was shown, until the visitor's hand goes on from it

  constructor(scene) {
    this.up = unit(scene.up);
    const seed = Math.abs(this.up[0]) < 0.9 ? [1, 0, 0] : [0, 0, 1];
    this.north = unit(sub(seed, this.up.map((u) => u * dot(seed, this.up))));
    this.east = cross(this.north, this.up);
    this.focus = scene.focus_centre;
    this.radius = Math.max(scene.focus_radius, 1e-3);
    this.fovY = 0.8;
    this.home();
  }

  /** The whole scene in view. */
  home() {
    this.#followed = null;
    Object.assign(this, { yaw: Math.PI / 4, pitch: -0.25, distance: this.radius * 2.2, target: [...this.focus] });
  }

  /** Go on from a pose that was shown; a roll is left behind. */
  follow(shown) {
    this.fovY = shown.fov_y;
    this.#followed = shown;
  }

  #settle() {
    if (!this.#followed) return;
    const { position, rotation } = this.#followed;
    this.#followed = null;
    const forward = axesOf(rotation)[2];
    this.pitch = clamp(Math.asin(clamp(dot(forward, this.up), -1, 1)), -MAX_PITCH, MAX_PITCH);
    this.yaw = Math.atan2(dot(forward, this.east), dot(forward, this.north));
    this.distance = Math.max(dot(sub(this.focus, position), forward), this.radius * 0.2);
    this.target = add(position, this.#axes()[2], this.distance);
  }

  #axes() {
    const level = add(this.north.map((n) => n * Math.cos(this.yaw)), this.east, Math.sin(this.yaw));
    const forward = add(level.map((l) => l * Math.cos(this.pitch)), this.up, Math.sin(this.pitch));
    const right = unit(cross(forward, this.up));
    return [right, cross(forward, right), forward];
  }

  pose() {
    this.#settle();
    const axes = this.#axes();
    return { position: add(this.target, axes[2], -this.distance), rotation: quaternionOf(axes) };
  }

  /** Turn about the target by angles in radians. */
  orbit(yaw, pitch) {
    this.#settle();
    this.yaw += yaw;
    this.pitch = clamp(this.pitch + pitch, -MAX_PITCH, MAX_PITCH);
  }

  /** Turn on the spot by angles in radians. */
  look(yaw, pitch) {
    const eye = this.pose().position;
    this.orbit(yaw, pitch);
    this.target = add(eye, this.#axes()[2], this.distance);
  }

  /** Move by shares of the target's distance along right, down and forward. */
  move(right, down, forward) {
    this.#settle();
    const axes = this.#axes();
    const step = [right, down, forward];
    axes.forEach((axis, i) => (this.target = add(this.target, axis, step[i] * this.distance)));
  }

  /** Come nearer to the target (factor under 1) or go away. */
  dolly(factor) {
    this.#settle();
    this.distance = clamp(this.distance * factor, this.radius * 0.05, this.radius * 40);
  }
}

const TURN_PER_PX = 0.0055;
const FLY_PER_S = 0.7;
const TURN_PER_S = 1.4;
const MOVES = { KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyQ: [0, -1, 0], KeyE: [0, 1, 0], KeyW: [0, 0, 1], KeyS: [0, 0, -1] };
const TURNS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const ZOOMS = { Equal: 1, NumpadAdd: 1, Minus: -1, NumpadSubtract: -1 };

/** Mouse, touch and keys on `element` drive `camera`; `moved(timeStamp)` is called after each change. */
export class Gestures {
  #pointers = new Map();
  #keys = new Set();
  #last = 0;

  constructor(element, camera, moved) {
    this.element = element;
    this.camera = camera;
    this.moved = moved;
    this.flying = false;
    element.addEventListener("pointerdown", (event) => this.#down(event));
    element.addEventListener("pointermove", (event) => this.#move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"])
      element.addEventListener(kind, (event) => this.#pointers.delete(event.pointerId));
    element.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    addEventListener("blur", () => this.#keys.clear());
  }

  /** Whether the key is the camera's; held keys move it until they are let go. */
  key(event, down) {
    if (!(event.code in MOVES || event.code in TURNS || event.code in ZOOMS)) return false;
    if (!down) this.#keys.delete(event.code);
    else if (!event.ctrlKey && !event.metaKey && !event.altKey) {
      if (!this.#keys.size) this.#step(event.timeStamp);
      if (!this.#keys.has(event.code)) {
        this.#press(event.code, TAP_S); // a tap may be over before the next refresh of the screen
        this.moved(event.timeStamp);
      }
      this.#keys.add(event.code);
    } else return false;
    return true;
  }

  #press(code, seconds) {
    if (code in MOVES) this.camera.move(...MOVES[code].map((m) => m * FLY_PER_S * seconds));
    if (code in TURNS) this.#turn(...TURNS[code].map((t) => t * TURN_PER_S * seconds));
    if (code in ZOOMS) this.camera.dolly(Math.exp(-ZOOMS[code] * seconds * 1.5));
  }

  #step(from) {
    this.#last = from;
    requestAnimationFrame((now) => {
      if (!this.#keys.size) return;
      const seconds = clamp((now - this.#last) / 1000, 0.004, 0.1);
      for (const code of this.#keys) this.#press(code, seconds);
      this.moved(now);
      this.#step(now);
    });
  }

  #turn(yaw, pitch) {
    if (this.flying) this.camera.look(yaw, pitch);
    else this.camera.orbit(-yaw, -pitch);
  }

  #down(event) {
    this.element.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, [event.clientX, event.clientY]);
    this.element.focus({ preventScroll: true });
  }

  #move(event) {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    if (!dx && !dy) return;
    const spread = this.#spread();
    this.#pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const pan = event.shiftKey || event.buttons & 6 || this.#pointers.size > 1;
    if (pan) {
      const scale = (2 * Math.tan(this.camera.fovY / 2)) / this.element.clientHeight / this.#pointers.size;
      this.camera.move(-dx * scale, -dy * scale, 0);
      if (spread) this.camera.dolly(spread / this.#spread());
    } else if (this.flying) this.camera.look(-dx * TURN_PER_PX * 0.6, dy * TURN_PER_PX * 0.6);
    else this.camera.orbit(dx * TURN_PER_PX, -dy * TURN_PER_PX);
    this.moved(event.timeStamp);
  }

  #spread() {
    if (this.#pointers.size < 2) return 0;
    const [a, b] = [...this.#pointers.values()];
    return Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1);
  }

  #wheel(event) {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === 1 ? 30 : 1);
    this.camera.dolly(Math.exp(clamp(pixels, -200, 200) * 0.0012));
    this.moved(event.timeStamp);
  }
}
