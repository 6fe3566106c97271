/**
 * The startup buffer: how long the first frame is held, and refined, before the clip plays; as
 * `cags_client.playback.startup`, by the same numbers.
 */

/** The longest hold of the first frame. */
export const STARTUP_US = 1_500_000;
/** The hold ends when no tile has arrived for this long, nor a part of one: over a slow link one may take longer. */
const QUIET_US = 250_000;
/** The same from the codebooks on until the first tile after them: what waited behind them, as references planned
 * meanwhile, comes before the tiles. */
const UNREFINED_QUIET_US = 1_000_000;
/** While tiles arrive, the held frame is redrawn at this interval. */
const PREVIEW_EVERY_US = 200_000;

/** Decides how long one play holds its first frame. */
export class Startup {
  readonly #mostUs: number;
  #newestUs: number;
  #drawnUs: number;
  #wholeUs: number | undefined;
  #equippedUs: number;
  #equipped = true;
  #refined = true;
  /** Order of the newest reference that had come when the hold began: those up to it, drawn for a page with few splats or
   * none, would spoil what was refined since. They are forgotten when the clip plays. */
  greeting = 0;

  /** `mostUs`: the longest hold. */
  constructor(mostUs: number, nowUs: number) {
    this.#mostUs = mostUs;
    this.#newestUs = this.#drawnUs = this.#equippedUs = nowUs;
  }

  /** A `tile` has arrived, or codebooks, or a part of a message; `equipped`: after the codebooks of all levels. Before,
   * nothing can be refined, and the hold does not end. */
  came(nowUs: number, tile: boolean, equipped: boolean): void {
    this.#refined = this.#equipped && (tile || this.#refined);
    if (equipped && !this.#equipped) this.#equippedUs = nowUs;
    this.#newestUs = nowUs;
    this.#equipped = equipped;
  }

  /** A frame is complete. Whether it is the first one, whose hold begins now. */
  whole(nowUs: number): boolean {
    if (this.#wholeUs !== undefined) return false;
    this.#wholeUs = nowUs;
    return true;
  }

  /** Whether the first frame is complete. */
  get isWhole(): boolean {
    return this.#wholeUs !== undefined;
  }

  /** When the hold ends if nothing more arrives; undefined before the first frame is complete and can be refined. */
  get endsUs(): number | undefined {
    if (this.#wholeUs === undefined || !this.#equipped) return undefined;
    const begunUs = Math.max(this.#wholeUs, this.#equippedUs);
    const quietUs = this.#refined ? QUIET_US : UNREFINED_QUIET_US;
    return Math.min(begunUs + this.#mostUs, Math.max(this.#newestUs + quietUs, this.#wholeUs));
  }

  /** Whether to redraw the held frame now that more of it has arrived. */
  preview(nowUs: number): boolean {
    if (nowUs - this.#drawnUs < PREVIEW_EVERY_US) return false;
    this.#drawnUs = nowUs;
    return true;
  }
}
