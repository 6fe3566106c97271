/** What of a chunk of motion hangs on the time, and that part of it by itself; as `in_motion` of
 * `cags_common.motion.parts` and `MovingTile.in_motion` of `cags_common.motion.apply`. */
import type { Chunk } from "./chunk.ts";

/** Share of a chunk's splats above which all of them are taken for restless: leaving the others out costs more. */
const MOST_RESTLESS = 0.875;

/** Splats of a chunk, ascending, that may be elsewhere at another time of its span; undefined: most of them. */
export function restless({ splats, span, moves, turns, fades, lives }: Chunk): Int32Array | undefined {
  const found = new Uint8Array(splats);
  if (fades) for (let i = 0; i < splats; i++) if (Number.isFinite(fades[2 * i + 1]!)) found[i] = 1;
  if (lives) for (let i = 0; i < splats; i++) if (lives[i]! <= span) found[i] = 1;
  for (const samples of [moves, turns]) if (samples && !most(found)) findVarying(samples, span, found);
  return most(found) ? undefined : where(found);
}

/** Set `found` [count] of those whose `samples` [span + 1, count, parts] are not all the same. */
function findVarying(samples: Int32Array, span: number, found: Uint8Array): void {
  const each = samples.length / (span + 1);
  const parts = each / found.length;
  for (let sample = 1; sample <= span; sample++) {
    for (let k = 0, at = sample * each; k < each; k++, at++) if (samples[at] !== samples[k]) found[Math.floor(k / parts)] = 1;
  }
}

function most(found: Uint8Array): boolean {
  let count = 0;
  for (const flag of found) count += flag;
  return count > MOST_RESTLESS * found.length;
}

/** Splats `of` a chunk, rising. */
export function partOf(chunk: Chunk, of: Int32Array): Chunk {
  const { splats, span, lives, fades } = chunk;
  const samplesOf = (samples: Int32Array | undefined): Int32Array | undefined => samples && pickOfSamples(samples, span, splats, of);
  return {
    ...chunk, splats: of.length, lives: lives && pick(lives, of), fades: fades && pick(fades, of, 2),
    moves: samplesOf(chunk.moves), turns: samplesOf(chunk.turns),
  };
}

/** Rows `of` an array of `width` numbers a row. */
export function pick<T extends Int32Array | Float32Array | Uint8Array>(from: T, of: Int32Array, width = 1): T {
  const out = new (from.constructor as new (length: number) => T)(of.length * width);
  for (let i = 0; i < of.length; i++) for (let d = 0; d < width; d++) out[i * width + d] = from[of[i]! * width + d]!;
  return out;
}

/** Of `samples` [span + 1, count, parts] those `of` some. */
function pickOfSamples(samples: Int32Array, span: number, count: number, of: Int32Array): Int32Array {
  const [each, parts] = [samples.length / (span + 1), samples.length / (span + 1) / count];
  const out = new Int32Array((span + 1) * of.length * parts);
  for (let sample = 0; sample <= span; sample++) {
    out.set(pick(samples.subarray(sample * each, (sample + 1) * each), of, parts), sample * of.length * parts);
  }
  return out;
}

function where(flags: Uint8Array): Int32Array {
  const out = new Int32Array(flags.length);
  let count = 0;
  for (let i = 0; i < flags.length; i++) if (flags[i]) out[count++] = i;
  return out.slice(0, count);
}
