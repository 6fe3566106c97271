/**
 * What one device does with its time: the share of media frames it displays, their pixels, and the pictures between;
 * as `cags_client.playback.quality`, where the rules are told.
 */

import { EVERY_FRAME, LEAST_PERMILLE, nextDisplayed } from "../wire/cadence.ts";

const SPLAT_SHARE = 0.2;
const DOWN_AFTER_US = 250_000;
const UP_AFTER_US = 2_000_000;
const UP_AFTER_MOST_US = 32_000_000;
const SMOOTHING_US = 300_000;
const HITCH = 2;
const UP_SHARE = 0.8;
const LEAST_GAIN = 0.95;
const WORTH_GAIN = 0.8;
const SLOW = 0.85;
const HEADROOM = 1.05;
const MOST_FALL = 0.5;
const STEADY = 0.06;
const LEAST_PICTURES = 1.25;
const EVEN_PICTURES = 1.9;
const CAUTION = 1.25;

export type Between = "off" | "on" | "auto";

export class Quality {
  /** From one media frame to the next. */
  periodUs: number;
  /** From one refresh of the display to the next. */
  displayUs: number;
  /** How many of 1,000 media frames are displayed. */
  permille = EVERY_FRAME;
  #scales: readonly number[];
  readonly #skips: boolean;
  #between: Between = "off";
  #fixedUs = 0;
  #fixedBetweenUs = 0;
  #pixelsUs = 0; // at full resolution
  #lastUs: number | null = null;
  #seenBetween = false;
  #overSinceUs: number | null = null;
  #roomSinceUs: number | null = null;
  #steppedUpUs: number | null = null;
  #patienceUs = DOWN_AFTER_US;
  #level: number; // among the scales, and after them among the densities of pictures between frames

  /** `scales`: shares of the display's width that may be drawn, rising. `skips`: whether frames may be left out. */
  constructor(scales: readonly number[], displayUs: number, skips = true) {
    this.periodUs = this.displayUs = displayUs;
    this.#scales = scales;
    this.#skips = skips;
    this.#level = scales.length - 1;
  }

  // ---------------------------------------------------------------------------------------------------------- decisions

  /** Share of the display's width that is drawn. */
  get scale(): number {
    return this.#scaleOf(this.#level);
  }

  /** From one picture to the next between media frames; undefined: there are none. */
  get stepUs(): number | undefined {
    if (this.#between === "on") return this.#mostBetween ? this.displayUs : undefined;
    return this.#stepOf(this.#level);
  }

  /** Whether a picture between frames, begun now, is done before the media frame due at `dueUs`. */
  fits(nowUs: number, dueUs: number): boolean {
    return this.#between === "on" || nowUs + CAUTION * this.#betweenUs(this.scale) <= dueUs;
  }

  // ---------------------------------------------------------------------------------------------------------- knowledge

  /** What may be chosen among. Where that changes, nothing of what was decided stays; all that was measured does. */
  wish(scales: readonly number[], between: Between): void {
    const same = scales.length === this.#scales.length && scales.every((scale, i) => scale === this.#scales[i]);
    if (same && between === this.#between) return;
    this.#scales = scales;
    this.#between = between;
    this.#level = scales.length - 1;
    this.#patienceUs = DOWN_AFTER_US;
    this.permille = EVERY_FRAME;
    this.#steppedUpUs = null;
    this.restart();
  }

  /** The play goes on elsewhere or otherwise: the while that was under way counts for nothing. */
  restart(): void {
    this.#overSinceUs = this.#roomSinceUs = null;
  }

  /** A picture was done at `nowUs`; `pixelsUs` of what it took went into its pixels. `media`: not one between two. */
  observe(nowUs: number, tookUs: number, pixelsUs: number, media = true): void {
    this.#learn(nowUs, tookUs, pixelsUs, media);
    this.#level = Math.min(this.#level, this.#scales.length - 1 + this.#mostBetween); // the display may be slower now
    if (this.#over) {
      this.#roomSinceUs = null;
      this.#overSinceUs ??= nowUs;
      if (nowUs - this.#overSinceUs >= DOWN_AFTER_US) this.#stepDown(nowUs);
      return;
    }
    this.#overSinceUs = null;
    if (!this.#room) {
      this.#roomSinceUs = null;
      return;
    }
    this.#roomSinceUs ??= nowUs;
    if (nowUs - this.#roomSinceUs >= this.#patienceUs) this.#stepUp(nowUs);
  }

  #learn(nowUs: number, tookUs: number, pixelsUs: number, media: boolean): void {
    const passed = this.#lastUs === null ? SMOOTHING_US : Math.max(nowUs - this.#lastUs, 0);
    this.#lastUs = nowUs;
    const expected = media ? this.#mediaUs(this.scale) : this.#betweenUs(this.scale);
    const counts = tookUs > 0 ? Math.min(Math.max(HITCH * expected, this.periodUs) / tookUs, 1) : 1;
    const pixels = Math.min(pixelsUs, tookUs) * counts;
    const fixed = tookUs * counts - pixels;
    const weight = passed / (passed + SMOOTHING_US);
    this.#pixelsUs += weight * (pixels / relative(this.scale) - this.#pixelsUs);
    if (media) this.#fixedUs += weight * (fixed - this.#fixedUs);
    else {
      this.#fixedBetweenUs += (this.#seenBetween ? weight : 1) * (fixed - this.#fixedBetweenUs);
      this.#seenBetween = true;
    }
  }

  // -------------------------------------------------------------------------------------------------------------- levels

  /** Levels of pictures between frames: each next one has twice as many, the last one as many as the display. */
  get #mostBetween(): number {
    let levels = 0;
    let stepUs = this.displayUs;
    for (let least = LEAST_PICTURES; this.#between !== "off" && least * stepUs <= this.periodUs; least = EVEN_PICTURES) {
      levels++;
      stepUs *= 2;
    }
    return levels;
  }

  #scaleOf(level: number): number {
    return this.#scales[Math.min(level, this.#scales.length - 1)]!;
  }

  #stepOf(level: number): number | undefined {
    const beyond = level - (this.#scales.length - 1);
    const most = this.#mostBetween;
    return beyond > 0 && beyond <= most ? this.displayUs * 2 ** (most - beyond) : undefined;
  }

  #mediaUs(scale: number): number {
    return this.#fixedUs + this.#pixelsUs * relative(scale);
  }

  #betweenUs(scale: number): number {
    return (this.#seenBetween ? this.#fixedBetweenUs : this.#fixedUs) + this.#pixelsUs * relative(scale);
  }

  /** What the pictures of one period take at a level. */
  #takesUs(level: number): number {
    const scale = this.#scaleOf(level);
    const stepUs = this.#between === "on" ? this.stepUs : this.#stepOf(level);
    const more = stepUs === undefined ? 0 : (this.periodUs / stepUs - 1) * this.#betweenUs(scale);
    return this.#mediaUs(scale) + more;
  }

  /** Whether there is a lower level that helps. */
  get #lower(): boolean {
    const takesUs = this.#takesUs(this.#level);
    if (this.#level === 0 || this.#takesUs(this.#level - 1) > LEAST_GAIN * takesUs) return false;
    if (this.#level >= this.#scales.length) return true;
    const leastUs = this.#takesUs(0);
    const slow = SLOW * takesUs > this.periodUs;
    return leastUs <= WORTH_GAIN * takesUs || (slow && leastUs <= this.periodUs);
  }

  get #top(): number {
    return this.#scales.length - 1 + (this.#between === "auto" ? this.#mostBetween : 0);
  }

  /** Whether what is drawn takes too long, and something can be done about it. */
  get #over(): boolean {
    const takesUs = this.#takesUs(this.#level);
    if (this.#lower) return takesUs > this.periodUs;
    if (this.permille === EVERY_FRAME) return this.#skips && SLOW * takesUs > this.periodUs;
    return this.permille > LEAST_PERMILLE && this.#affordable < (1 - STEADY) * this.permille;
  }

  /** Whether there is time for the next level up. */
  get #room(): boolean {
    if (this.permille < EVERY_FRAME) {
      const wanted = this.#possible;
      return wanted === EVERY_FRAME || wanted > (1 + STEADY) * this.permille;
    }
    if (this.#level >= this.#top) return false;
    const takesUs = this.#takesUs(this.#level + 1);
    const gains = this.#level + 1 >= this.#scales.length || this.#takesUs(0) <= WORTH_GAIN * takesUs;
    return takesUs <= (gains ? UP_SHARE : 1) * this.periodUs;
  }

  /** How many pictures there is time for while 1,000 media frames are due: of any size. */
  get #affordable(): number {
    const takesUs = this.#takesUs(this.#level);
    return takesUs > 0 ? (HEADROOM * EVERY_FRAME * this.periodUs) / takesUs : Infinity;
  }

  /** How many of 1,000 media frames to display, by what they take. */
  get #possible(): number {
    return Math.max(Math.floor(Math.min(this.#affordable, EVERY_FRAME)), LEAST_PERMILLE);
  }

  // --------------------------------------------------------------------------------------------------------------- steps

  #stepDown(nowUs: number): void {
    const hasty = this.#steppedUpUs !== null && nowUs - this.#steppedUpUs < 2 * this.#patienceUs;
    this.#patienceUs = hasty ? Math.min(Math.max(2 * this.#patienceUs, UP_AFTER_US), UP_AFTER_MOST_US) : UP_AFTER_US;
    if (this.#lower) this.#level--;
    else this.permille = Math.max(this.#possible, Math.floor(this.permille * MOST_FALL), LEAST_PERMILLE);
    this.#steppedUpUs = null;
    this.restart();
  }

  #stepUp(nowUs: number): void {
    if (this.permille < EVERY_FRAME) this.permille = this.#possible;
    else this.#level++;
    this.#steppedUpUs = nowUs;
    this.restart();
  }
}

/** The first tick to display from `tick` on; that before `endTick` is displayed in any case. */
export function nextDue(tick: number, endTick: number, permille: number): number {
  return Math.min(nextDisplayed(tick, permille), endTick - 1);
}

/** The newest tick due of those to display from `tick` on, which is one of them. */
export function newestDue(tick: number, endTick: number, permille: number, isDue: (tick: number) => boolean): number {
  let newest = tick;
  for (let later; (later = nextDue(newest + 1, endTick, permille)) > newest && isDue(later); ) newest = later;
  return newest;
}

/** What pixels cost at `scale`, full resolution being 1. */
function relative(scale: number): number {
  return SPLAT_SHARE + (1 - SPLAT_SHARE) * scale * scale;
}
