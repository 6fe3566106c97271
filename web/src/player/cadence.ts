/** How many of the media frames are displayed: all, or as many as this machine can draw; see `cags_client.cadence`. */

import { EVERY_FRAME, nextDisplayed } from "../wire/cadence.ts";

const LEAST_PERMILLE = 250;
const WINDOW_US = 1_000_000;
const LEAST_DRAWN = 4;
const SLOW = 0.85;
const HEADROOM = 1.05;
const MOST_FALL = 0.5;
const STEADY = 0.06;

export class Cadence {
  /** How many of 1,000 media frames are displayed. */
  permille = EVERY_FRAME;
  /** The media frame that the newest control named; each loop since takes a clip's frames off it. */
  countedFrom: number;
  #sinceUs: number | null = null;
  #begunUs = 0;
  #busyUs = 0;
  #due = 0;
  #chosen = 0;
  #drawn = 0;

  constructor(firstFrame: number) {
    this.countedFrom = firstFrame;
  }

  /** The first media frame to display from `frame` on; that before `endFrame` is displayed in any case. */
  next(frame: number, endFrame: number): number {
    return Math.min(this.countedFrom + nextDisplayed(frame - this.countedFrom, this.permille), endFrame - 1);
  }

  /** The frame to draw now: the newest one due of those to display from `fromFrame` on. */
  newestDue(nowUs: number, fromFrame: number, endFrame: number, dueUs: (frame: number) => number): number {
    let frame = this.next(fromFrame, endFrame);
    let missed = 0;
    for (let later; (later = this.next(frame + 1, endFrame)) > frame && dueUs(later) <= nowUs; missed++) frame = later;
    if (this.#sinceUs === null) this.#begin(nowUs);
    this.#begunUs = nowUs;
    this.#due += frame + 1 - fromFrame;
    this.#chosen += 1 + missed;
    return frame;
  }

  /** The frame that was handed out is drawn. */
  drawn(nowUs: number): void {
    if (this.#sinceUs === null) return;
    this.#busyUs += nowUs - this.#begunUs;
    this.#drawn++;
    if (nowUs - this.#sinceUs >= WINDOW_US && this.#drawn >= LEAST_DRAWN) {
      this.#choose(nowUs - this.#sinceUs);
      this.#begin(nowUs);
    }
  }

  /** A control names `frame`: the window that was under way counts for nothing. */
  restart(frame: number): void {
    this.countedFrom = frame;
    this.#sinceUs = null;
  }

  #begin(nowUs: number): void {
    this.#sinceUs = nowUs;
    this.#busyUs = this.#due = this.#chosen = this.#drawn = 0;
  }

  #choose(windowUs: number): void {
    if (this.permille === EVERY_FRAME && this.#drawn >= SLOW * this.#chosen) return;
    const possible = ((this.#drawn / this.#due) * windowUs) / Math.max(this.#busyUs, 1);
    const least = Math.max(Math.round(this.permille * MOST_FALL), LEAST_PERMILLE);
    const wanted = Math.min(Math.max(Math.round(possible * HEADROOM * EVERY_FRAME), least), EVERY_FRAME);
    if (wanted === EVERY_FRAME || Math.abs(wanted - this.permille) > STEADY * this.permille) this.permille = wanted;
  }
}
