/**
 * The startup buffer: how long the first frame is held, and refined, before the clip plays; as
 * `cags_client.playback.startup`, by the same numbers.
 */

/** The longest hold of the first frame. */
export const STARTUP_US = 1_500_000;
/** The hold ends when no tile has arrived for this long, nor a part of one: over a slow link one may take longer. */
const QUIET_US = 250_000;
/** While tiles arrive, the held frame is redrawn at this interval. */
const PREVIEW_EVERY_US = 200_000;

/** Decides how long one play holds its first frame. */
export class Startup {
  readonly #mostUs: number;
  #newestUs: number;
  #drawnUs: number;
  #wholeUs: number | undefined;
  /** Order of the newest reference that had come when the hold began: those up to it, drawn for a page with few splats or
   * none, would spoil what was refined since. They are forgotten when the clip plays. */
  greeting = 0;

  /** `mostUs`: the longest hold. */
  constructor(mostUs: number, nowUs: number) {
    this.#mostUs = mostUs;
    this.#newestUs = this.#drawnUs = nowUs;
  }

  /** A tile has arrived, or a part of a message. */
  came(nowUs: number): void {
    this.#newestUs = nowUs;
  }

  /** A frame is complete. Whether it is the first one, whose hold begins now. */
  whole(nowUs: number): boolean {
    if (this.#wholeUs !== undefined) return false;
    this.#wholeUs = nowUs;
    return true;
  }

  /** When the hold ends if nothing more arrives; undefined before the first frame is complete. */
  get endsUs(): number | undefined {
    if (this.#wholeUs === undefined) return undefined;
    return Math.min(this.#wholeUs + this.#mostUs, Math.max(this.#newestUs + QUIET_US, this.#wholeUs));
  }

  /** Whether to redraw the held frame now that more of it has arrived. */
  preview(nowUs: number): boolean {
    if (nowUs - this.#drawnUs < PREVIEW_EVERY_US) return false;
    this.#drawnUs = nowUs;
    return true;
  }
}
