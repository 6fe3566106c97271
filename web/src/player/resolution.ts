/** Pixels that a frame is worked out at: as many as its time allows. */

/** Share of the full picture's width. */
const SCALES = [0.35, 0.5, 0.7, 1] as const;
const SMOOTHING = 0.15;
const DOWN_SHARE = 0.95;
const DOWN_AFTER_MS = 700;
const UP_SHARE = 0.6;
const UP_AFTER_MS = 3000;
/** Longest pause between a step up that proved too much and the next one. */
const MOST_PATIENCE_MS = 60_000;

export class Resolution {
  readonly #budgetMs: number;
  #place: number = SCALES.length - 1;
  #takesMs: number | null = null;
  #overSinceMs: number | null = null;
  #roomSinceMs: number | null = null;
  #patienceMs = UP_AFTER_MS;
  #wentUpMs = -Infinity;

  /** `budgetMs`: how long a frame may take. */
  constructor(budgetMs: number) {
    this.#budgetMs = budgetMs;
  }

  get scale(): number {
    return SCALES[this.#place];
  }

  /** A frame took `frameMs` at {@link scale}. */
  observe(nowMs: number, frameMs: number): void {
    this.#takesMs = this.#takesMs === null ? frameMs : this.#takesMs + SMOOTHING * (frameMs - this.#takesMs);
    if (this.#place > 0 && this.#takesMs > DOWN_SHARE * this.#budgetMs) {
      this.#overSinceMs ??= nowMs;
      if (nowMs - this.#overSinceMs >= DOWN_AFTER_MS) this.#down(nowMs);
      return;
    }
    this.#overSinceMs = null;
    if (this.#place + 1 === SCALES.length || this.#takesMs * this.#growth() > UP_SHARE * this.#budgetMs) this.#roomSinceMs = null;
    else {
      this.#roomSinceMs ??= nowMs;
      if (nowMs - this.#roomSinceMs >= this.#patienceMs) this.#up(nowMs);
    }
  }

  #growth(): number {
    return (SCALES[this.#place + 1] / SCALES[this.#place]) ** 2;
  }

  #down(nowMs: number): void {
    const hasty = nowMs - this.#wentUpMs < 2 * this.#patienceMs;
    this.#patienceMs = hasty ? Math.min(2 * this.#patienceMs, MOST_PATIENCE_MS) : UP_AFTER_MS;
    this.#place--;
    this.#forget();
  }

  #up(nowMs: number): void {
    this.#place++;
    this.#wentUpMs = nowMs;
    this.#forget();
  }

  #forget(): void {
    this.#takesMs = this.#overSinceMs = this.#roomSinceMs = null;
  }
}
