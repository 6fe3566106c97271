/** Mouse, touch, keys and gamepad move a camera. */

import type { ViewCamera } from "./camera.ts";
import { clamp } from "./vectors.ts";

const TURN_PER_PX = 0.0055;
const MOVES_PER_S = 0.7;
const TURNS_PER_S = 1.4;
/** What a key moves before the next refresh of the screen, however short it was pressed. */
const TAP_S = 1 / 60;
const STICK_REST = 0.15;

const MOVES: Readonly<Record<string, readonly [number, number, number]>> = {
  KeyA: [-1, 0, 0],
  KeyD: [1, 0, 0],
  KeyQ: [0, 1, 0],
  KeyE: [0, -1, 0],
  KeyW: [0, 0, 1],
  KeyS: [0, 0, -1],
};
const TURNS: Readonly<Record<string, readonly [right: number, up: number]>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
};
const ZOOMS: Readonly<Record<string, number>> = { Equal: 1, NumpadAdd: 1, Minus: -1, NumpadSubtract: -1 };

export class Gestures {
  readonly #element: HTMLElement;
  readonly #pointers = new Map<number, readonly [number, number]>();
  readonly #keys = new Set<string>();
  #camera: ViewCamera | null = null;
  #lastMs = 0;

  /** `onTap`: a press that moved nothing. */
  constructor(element: HTMLElement, onTap: () => void) {
    this.#element = element;
    let moved = 0;
    element.addEventListener("pointerdown", (event) => {
      moved = 0;
      element.setPointerCapture(event.pointerId);
      this.#pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    element.addEventListener("pointermove", (event) => (moved += this.#drag(event)));
    element.addEventListener("pointerup", () => void (moved < 5 && this.#pointers.size === 1 && onTap()));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const)
      element.addEventListener(kind, (event) => void this.#pointers.delete((event as PointerEvent).pointerId));
    element.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    addEventListener("blur", () => this.#keys.clear());
  }

  /** Drive this camera from now on. */
  drive(camera: ViewCamera): void {
    this.#camera = camera;
  }

  /** Whether the key is the camera's; held keys move it until they are let go. */
  key(event: KeyboardEvent, down: boolean): boolean {
    const { code } = event;
    if (!(code in MOVES || code in TURNS || code in ZOOMS)) return false;
    if (!down) this.#keys.delete(code);
    else if (event.ctrlKey || event.metaKey || event.altKey) return false;
    else if (!this.#keys.has(code)) {
      this.#keys.add(code);
      this.#press(code, TAP_S);
    }
    return true;
  }

  /** Before each picture: what is held down moves on. */
  step(nowMs: number): void {
    const seconds = clamp((nowMs - this.#lastMs) / 1000, 0, 0.1);
    this.#lastMs = nowMs;
    for (const code of this.#keys) this.#press(code, seconds);
    for (const pad of navigator.getGamepads?.() ?? []) if (pad) this.#stick(pad, seconds);
  }

  #press(code: string, seconds: number): void {
    const camera = this.#camera;
    if (!camera) return;
    const [right, down, forward] = MOVES[code] ?? [0, 0, 0];
    if (code in MOVES) camera.move(right * MOVES_PER_S * seconds, down * MOVES_PER_S * seconds, forward * MOVES_PER_S * seconds);
    const [across, up] = TURNS[code] ?? [0, 0];
    if (code in TURNS) camera.turn(across * TURNS_PER_S * seconds, up * TURNS_PER_S * seconds);
    if (code in ZOOMS) camera.dolly(Math.exp(-ZOOMS[code] * seconds * 1.5));
  }

  #stick(pad: Gamepad, seconds: number): void {
    const [x, y, across, down] = [0, 1, 2, 3].map((i) => (Math.abs(pad.axes[i] ?? 0) < STICK_REST ? 0 : pad.axes[i]));
    if (x || y) this.#camera?.move(x * MOVES_PER_S * seconds, 0, -y * MOVES_PER_S * seconds);
    if (across || down) this.#camera?.turn(across * TURNS_PER_S * seconds, -down * TURNS_PER_S * seconds);
  }

  /** Returns how far a pointer went, pixels. */
  #drag(event: PointerEvent): number {
    const before = this.#pointers.get(event.pointerId);
    const camera = this.#camera;
    if (!before || !camera) return 0;
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    const spread = this.#spread();
    this.#pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (event.shiftKey || event.buttons & 6 || this.#pointers.size > 1) {
      const share = 1 / this.#element.clientHeight / this.#pointers.size;
      camera.pan(-dx * share, -dy * share);
      if (spread) camera.dolly(spread / this.#spread());
    } else camera.drag(dx * TURN_PER_PX, dy * TURN_PER_PX);
    return Math.hypot(dx, dy);
  }

  #spread(): number {
    if (this.#pointers.size < 2) return 0;
    const [a, b] = [...this.#pointers.values()];
    return Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1);
  }

  #wheel(event: WheelEvent): void {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === 1 ? 30 : 1);
    this.#camera?.dolly(Math.exp(clamp(pixels, -200, 200) * 0.0012));
  }
}
