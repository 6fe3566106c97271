/**
 * A play in a client that sends pictures: what the page asks of its player goes there, what it is told comes from there.
 *
 * There is one camera and one play, whoever looks. The page that the client lets steer them sends its poses with the times
 * at which the camera was there; the others watch, and so does this page until a hand moves its camera.
 */

import type { Playing } from "../page/show.ts";
import { nowUs, type Pose } from "../seam.ts";
import * as to from "./messages.ts";
import type { FrameHead, SceneText, StateText, Wish } from "./messages.ts";
import { type DecodedFrame, letGo } from "./pictures.ts";

/** A jump that was not seen for so long is not looked for any more: pictures may be left out. */
const SEEK_MS = 2000;
/** Times from hand to picture that are kept. */
const KEPT = 600;

/** What a player needs of the page. */
export interface ClientView {
  send(text: string): void;
  show(frame: DecodedFrame): void;
  /** Where the page's camera is. */
  pose(): Pose;
  /** Put the page's camera where the picture was taken. */
  follow(camera: FrameHead["camera"]): void;
  /** Say goodbye to the client. */
  leave(): void;
}

export class ClientPlayer implements Playing {
  info: SceneText | null = null;
  state: StateText | null = null;
  shown: FrameHead | null = null;
  shownMs = -Infinity;
  pictures = 0;
  /** From a pose to the drawing of the first picture that shows it, ms: the newest ones. */
  readonly photonMs: number[] = [];
  readonly #view: ClientView;
  #waiting: DecodedFrame | null = null;
  #wanted: { readonly frame: number; readonly untilMs: number } | null = null;
  #key = "";
  #mine = false;
  /** When the page's camera was where the newest picture shows it from; 0 before any such picture. */
  movedUs = 0;

  constructor(view: ClientView) {
    this.#view = view;
  }

  // ------------------------------------------------------------------------------------------------------------ told

  /** Nothing is known any more. */
  forget(): void {
    this.close();
    this.info = this.state = this.shown = null;
    this.#wanted = null;
  }

  /** The scene is known, of a client that may be another one: the camera is its own until a hand moves it. */
  meet(info: SceneText): void {
    this.info = info;
    this.#mine = false;
    this.standHere();
  }

  /** How things stand. */
  told(state: StateText): void {
    this.state = state;
    if (!state.steers) this.#mine = false;
  }

  /** A frame is decoded. The newest waits for the next refresh of the screen. A page that nobody sees says nothing of what
   * it was sent, so that the client soon draws no more for it; the first refresh afterwards says it all at once. */
  came(frame: DecodedFrame): void {
    if (this.#waiting) {
      if (!document.hidden) this.#drawn(this.#waiting);
      letGo(this.#waiting);
    }
    this.#waiting = frame;
  }

  /** A frame could not be decoded. */
  lost(number: number): void {
    this.#view.send(to.drawn(number, true));
  }

  // --------------------------------------------------------------------------------------------------- viewer's wishes

  play(): void {
    this.set("playing", true);
  }

  pause(): void {
    this.set("playing", false);
  }

  seek(frame: number): void {
    if (!this.info) return;
    const wanted = Math.max(0, Math.min(Math.round(frame), this.info.frames - 1));
    if (this.state?.steers !== false) this.#wanted = { frame: wanted, untilMs: performance.now() + SEEK_MS };
    this.set("frame", wanted);
  }

  setRate(rate: number): void {
    this.set("rate", rate);
  }

  setLoop(on: boolean): void {
    this.set("loop", on);
  }

  set(...wish: Wish): void {
    this.#view.send(to.set(...wish));
  }

  /** Follow the recorded walk again. */
  release(): void {
    this.#mine = false;
    this.set("held", false);
  }

  /** Hold the page's camera where it is, as if a hand had put it there. */
  hold(): void {
    this.#key = "";
  }

  /** The page's camera stands where it is by nobody's hand. */
  standHere(): void {
    this.#key = JSON.stringify(this.#view.pose());
  }

  /** What is drawn for a page follows from what it says it has shown: nothing is to be told. */
  rest(): void {}

  close(): void {
    this.#view.leave();
    if (this.#waiting) letGo(this.#waiting);
    this.#waiting = null;
  }

  // ---------------------------------------------------------------------------------------------------------- in time

  get playing(): boolean {
    return this.state?.playing ?? true;
  }

  get frame(): number {
    return this.#wanted?.frame ?? this.shown?.frame ?? 0;
  }

  get seconds(): number {
    return this.info ? this.frame / this.info.fps : 0;
  }

  get waiting(): boolean {
    return this.#wanted !== null || !this.shown;
  }

  /** Whether camera and play are this page's. */
  get steers(): boolean {
    return this.state?.steers ?? false;
  }

  step(): void {
    this.#sendPose();
    const frame = this.#waiting;
    this.#waiting = null;
    if (frame) this.#show(frame);
    if (this.#wanted && performance.now() > this.#wanted.untilMs) this.#wanted = null;
  }

  /** A camera that is not where it was left has been moved by a hand: it is the page's from now on. */
  #sendPose(): void {
    if (!this.info || JSON.stringify(this.#view.pose()) === this.#key) return;
    this.standHere();
    if (!this.steers) return;
    this.#mine = true;
    this.#view.send(to.moved(nowUs(), this.#view.pose()));
  }

  #show(frame: DecodedFrame): void {
    const { head } = frame;
    this.#view.show(frame);
    this.#drawn(frame);
    this.pictures++;
    this.shown = head;
    this.shownMs = performance.now();
    if (head.frame === this.#wanted?.frame) this.#wanted = null;
    if (head.pose_at_us !== null && head.pose_at_us > this.movedUs) {
      this.movedUs = head.pose_at_us;
      this.photonMs.push((nowUs() - head.pose_at_us) / 1000);
      if (this.photonMs.length > KEPT) this.photonMs.shift();
    }
    if (this.#mine) return;
    this.#view.follow(head.camera);
    this.standHere();
  }

  #drawn({ head }: DecodedFrame): void {
    this.#view.send(to.drawn(head.number, false));
  }
}
