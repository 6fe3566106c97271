/** The samples of a span in the order in which they are coded, and the classes of residuals; as `cags_common.motion`. */

export const FRACTION_BITS = 6;
const [START, END, MIDDLE] = [0, 1, 2];

/** Rows of (kind, at, left, right, parent) of `span` + 1 samples; sample 0 is coded only with `start`. */
export function knots(span: number, start: boolean): Int32Array {
  const rows: number[][] = start ? [[START!, 0, 0, 0, -1]] : [];
  rows.push([END!, span, 0, 0, start ? 0 : -1]);
  let intervals: number[][] = [[0, span, span]];
  while (intervals.length) {
    const below: number[][] = [];
    for (const [left, right, parent] of intervals as [number, number, number][]) {
      if (right - left < 2) continue;
      const at = Math.floor((left + right) / 2);
      rows.push([MIDDLE!, at, left, right, parent]);
      below.push([left, at, at], [at, right, at]);
    }
    intervals = below;
  }
  return Int32Array.from(rows.flat());
}

const MAGNITUDE = 63;
const EDGES = [0, 4, 9, 16, 28, 50, 100, 200, 440];
const UNKNOWN = 2;
const SUMS = 2 * 3 * MAGNITUDE + 2 * 6 * MAGNITUDE + 3 * 2 * MAGNITUDE + 1;
const WEIGHTS = 2 + 4 + 3;
export const CLASSES = EDGES.length + 1;

/** [9, 1513] class of a residual by what is known and what it tells. */
export function classTables(): Uint8Array {
  const out = new Uint8Array(WEIGHTS * SUMS).fill(UNKNOWN, 0, SUMS);
  for (let weight = 1; weight < WEIGHTS; weight++) {
    const edges = EDGES.map((edge) => Math.max(3 * weight * edge, 1));
    for (let sum = 0; sum < SUMS; sum++) out[weight * SUMS + sum] = edges.filter((edge) => edge <= 20 * sum).length;
  }
  return out;
}
