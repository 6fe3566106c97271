/** Attributes on their way from one value to the next; the rules are those of `cags_common.tiles.ramps`, and so are the bits. */

/** In place of the media frame of a predecessor: it is the looks' value. */
export const OF_LOOKS = -1;

interface Ramp {
  readonly begin: number;
  readonly frames: number;
  /** Media frame of the predecessor. */
  since: number;
  from: Float32Array;
  to: Float32Array;
}

/** The splats of which one attribute is on its way; rows are splat ids. */
export class Ramps {
  private readonly of = new Map<number, Ramp>();

  clear(): void {
    this.of.clear();
  }

  /** Forget `id`: its attribute has another value, at once. */
  drop(id: number): void {
    this.of.delete(id);
  }

  /** The value to which `id` is on its way, if it is. */
  end(id: number): Float32Array | undefined {
    return this.of.get(id)?.to;
  }

  /** `id` is on its way from media frame `begin` on for `frames`, between these values; `since` is the media frame of the
   * first. */
  put(id: number, begin: number, frames: number, from: Float32Array, to: Float32Array, since: number): void {
    this.of.set(id, { begin, frames, since, from, to });
  }

  /** Set the last value of `id` where it began at `frame`; whether it did. */
  refine(id: number, frame: number, value: Float32Array): boolean {
    const ramp = this.of.get(id);
    if (ramp?.begin !== frame) return false;
    ramp.to = value;
    return true;
  }

  /** An update of media `frame` has come with `value`: of a ramp that begins later it is the predecessor, unless a newer one is
   * known. */
  precede(id: number, frame: number, value: Float32Array): void {
    const ramp = this.of.get(id);
    if (!ramp || ramp.since > frame || frame >= ramp.begin) return;
    ramp.from = value;
    ramp.since = frame;
  }

  /** Looks of media `frame` have come: they precede a ramp whose predecessor is older. */
  standOn(id: number, frame: number, value: Float32Array): void {
    const ramp = this.of.get(id);
    if (!ramp || ramp.since >= frame) return;
    ramp.from = value;
    ramp.since = OF_LOOKS;
  }

  /** Whether the update of media `frame` is the predecessor of `id`. */
  follows(id: number, frame: number): boolean {
    return this.of.get(id)?.since === frame;
  }

  /** Write the values at `time` into `column`, of `width` numbers a row, and tell of each row and the media frame in which it
   * began; those that have reached their value are forgotten. */
  at(time: number, column: Float32Array, width: number, tell: (id: number, begin: number) => void): void {
    for (const [id, { begin, frames, from, to }] of this.of) {
      const share = Math.fround(Math.min((time + 1 - begin) / frames, 1));
      for (let d = 0; d < width; d++) {
        const [a, b] = [from[d]!, to[d]!];
        column[id * width + d] = share >= 1 ? b : Math.fround(a + Math.fround(Math.fround(b - a) * share));
      }
      if (share >= 1) this.of.delete(id);
      tell(id, begin);
    }
  }
}
