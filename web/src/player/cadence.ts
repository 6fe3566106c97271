/** How many of the media frames are displayed: all, or as many as this machine can draw; see `cags_client.cadence`. */

import { EVERY_FRAME, LEAST_PERMILLE, nextDisplayed } from "../wire/cadence.ts";

const WINDOW_US = 1_000_000;
const LEAST_DRAWN = 4;
const SLOW = 0.85;
const HEADROOM = 1.05;
const MOST_FALL = 0.5;
const STEADY = 0.06;

export class Cadence {
  /** How many of 1,000 media frames are displayed. */
  permille = EVERY_FRAME;
  #sinceUs: number | null = null;
  #begunUs = 0;
  #busyUs = 0;
  #due = 0;
  #chosen = 0;
  #drawn = 0;

  /** The first tick to display from `tick` on; that before `endTick` is displayed in any case. */
  next(tick: number, endTick: number): number {
    return Math.min(nextDisplayed(tick, this.permille), endTick - 1);
  }

  /** The tick to draw now: the newest one due of those to display from `fromTick` on. */
  newestDue(nowUs: number, fromTick: number, endTick: number, displayUs: (tick: number) => number): number {
    let tick = this.next(fromTick, endTick);
    let missed = 0;
    for (let later; (later = this.next(tick + 1, endTick)) > tick && displayUs(later) <= nowUs; missed++) tick = later;
    if (this.#sinceUs === null) this.#begin(nowUs);
    this.#begunUs = nowUs;
    this.#due += tick + 1 - fromTick;
    this.#chosen += 1 + missed;
    return tick;
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

  /** Ticks are counted anew: the window that was under way counts for nothing. */
  restart(): void {
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
