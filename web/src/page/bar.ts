/** The controls along the bottom, and their keys. */

import { MODES, type Mode } from "../player/camera.ts";
import { keep, kept, the } from "./dom.ts";
import { setIcon } from "./icons.ts";
import type { Playing } from "./show.ts";

/** Controls go after so long without a hand on them, while the clip plays. */
const IDLE_MS = 3500;
/** Keys that act again and again while they are held; the others would undo what they did. */
const REPEATING = new Set(["Comma", "Period"]);

export interface BarWishes {
  toggle(): void;
  seek(frame: number): void;
  mode(mode: Mode): void;
  home(): void;
  share(): void;
  snapshot(): void;
  record(): void;
  immerse(): void;
}

export class Bar {
  readonly #stage = the("stage");
  readonly #bar = the("bar");
  readonly #play = the("play");
  readonly #time = the<HTMLInputElement>("time");
  readonly #clock = the("clock");
  readonly #inspect = the("inspect");
  readonly #inspector = the("inspector");
  readonly #wishes: BarWishes;
  #dragged = false;
  #touchedMs = 0;

  constructor(wishes: BarWishes) {
    this.#wishes = wishes;
    setIcon(this.#play, "pause");
    for (const name of ["home", "share", "snapshot", "record", "inspect", "vr", "full"] as const) setIcon(the(name), name);
    this.#play.addEventListener("click", () => wishes.toggle());
    the("home").addEventListener("click", () => wishes.home());
    the("share").addEventListener("click", () => wishes.share());
    the("snapshot").addEventListener("click", () => wishes.snapshot());
    the("record").addEventListener("click", () => wishes.record());
    the("vr").addEventListener("click", () => wishes.immerse());
    the("full").addEventListener("click", () => fullScreen());
    this.#inspect.addEventListener("click", () => this.inspect(this.#inspector.hidden));
    the("full").hidden = !document.fullscreenEnabled; // a phone may have none, nor a frame that was not given it
    for (const button of this.#modes()) button.addEventListener("click", () => wishes.mode(button.dataset.mode as Mode));
    the("modes").addEventListener("keydown", (event) => this.#chooseMode(event));
    this.#time.addEventListener("input", () => (this.#dragged = true));
    this.#time.addEventListener("change", () => {
      this.#dragged = false;
      wishes.seek(Number(this.#time.value));
    });
    for (const kind of ["pointermove", "pointerdown", "keydown", "touchstart"]) addEventListener(kind, () => this.#touch(), { passive: true });
    new ResizeObserver(() => this.#stage.style.setProperty("--bar", `${this.#bar.offsetHeight}px`)).observe(this.#bar);
    this.inspect(kept("inspect") === "1");
  }

  /** Whether the instruments are open. */
  get inspecting(): boolean {
    return !this.#inspector.hidden;
  }

  inspect(open: boolean): void {
    if (!open && this.#inspector.contains(document.activeElement)) this.#inspect.focus();
    this.#inspector.hidden = !open;
    this.#inspect.setAttribute("aria-expanded", String(open));
    keep("inspect", open ? "1" : "0");
  }

  setMode(mode: Mode): void {
    for (const button of this.#modes()) {
      button.setAttribute("aria-checked", String(button.dataset.mode === mode));
      button.tabIndex = button.dataset.mode === mode ? 0 : -1;
    }
  }

  /** Arrows choose among the modes, as in any group of radio buttons. */
  #chooseMode(event: KeyboardEvent): void {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.code];
    if (step === undefined) return;
    event.preventDefault(); // nor do they turn the camera
    const buttons = this.#modes();
    const next = buttons.at((buttons.indexOf(event.target as HTMLElement) + step) % buttons.length)!;
    next.focus();
    next.click();
  }

  /** Show whether what is shown is being filmed. */
  setRecording(on: boolean): void {
    const button = the("record");
    button.setAttribute("aria-pressed", String(on));
    button.setAttribute("aria-label", on ? "Stop recording" : "Record a film");
  }

  /** Show the state of play. */
  update(player: Playing): void {
    const { info, playing } = player;
    if (!info) return;
    this.#bar.toggleAttribute("data-still", info.frames === 1);
    setIcon(this.#play, playing ? "pause" : "play");
    this.#play.setAttribute("aria-label", playing ? "Pause" : "Play");
    this.#time.max = String(info.frames - 1);
    const frame = this.#dragged ? Number(this.#time.value) : goneTo(player);
    if (!this.#dragged) this.#time.value = String(frame);
    const text = `${clock(frame / info.fps)} / ${clock(info.frames / info.fps)}`;
    if (this.#clock.textContent !== text) {
      this.#clock.textContent = text;
      this.#time.setAttribute("aria-valuetext", text);
    }
    const idle = playing && !player.waiting && !this.inspecting && performance.now() - this.#touchedMs > IDLE_MS;
    this.#stage.toggleAttribute("data-idle", idle);
  }

  /** Whether a key was one of the bar's. */
  key(event: KeyboardEvent, player: Playing | null): boolean {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const wishes: Record<string, () => void> = {
      Space: () => this.#wishes.toggle(),
      KeyF: () => fullScreen(),
      KeyI: () => this.inspect(!this.inspecting),
      KeyH: () => this.#wishes.home(),
      KeyL: () => this.#wishes.share(),
      KeyP: () => this.#wishes.snapshot(),
      KeyR: () => this.#wishes.record(),
      KeyV: () => this.#wishes.immerse(),
      Comma: () => player && this.#wishes.seek(goneTo(player) - 1),
      Period: () => player && this.#wishes.seek(goneTo(player) + 1),
      Escape: () => this.inspect(false),
    };
    MODES.forEach((mode, i) => (wishes[`Digit${i + 1}`] = () => this.#wishes.mode(mode)));
    const wish = wishes[event.code];
    if (acts(event)) wish?.();
    return wish !== undefined;
  }

  #modes(): HTMLElement[] {
    return [...the("modes").querySelectorAll<HTMLElement>("button")];
  }

  #touch(): void {
    this.#touchedMs = performance.now();
    this.#stage.removeAttribute("data-idle");
  }
}

/** The frame that was gone to last, even while another one is being drawn; else the one on display. */
export function goneTo({ info, seconds, frame }: Pick<Playing, "info" | "seconds" | "frame">): number {
  return info ? Math.round(seconds * info.fps) : frame;
}

/** Whether a key that goes down, or is held, does something (again). */
export function acts({ code, repeat }: Pick<KeyboardEvent, "code" | "repeat">): boolean {
  return !repeat || REPEATING.has(code);
}

function fullScreen(): void {
  if (document.fullscreenElement) void document.exitFullscreen();
  else void document.documentElement.requestFullscreen?.().catch(() => undefined);
}

function clock(seconds: number): string {
  const tenths = Math.floor(seconds * 10 + 1e-6);
  const [minutes, rest] = [Math.floor(tenths / 600), tenths % 600];
  return `${minutes}:${String(Math.floor(rest / 10)).padStart(2, "0")}.${rest % 10}`;
}
