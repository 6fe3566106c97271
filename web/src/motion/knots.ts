/** The samples of a span in the order in which they are coded, and the classes of residuals; as `cags_common.motion`. */

export const FRACTION_BITS = 6;
const [START, END, MIDDLE] = [0, 1, 2];

const WEIGHT_BITS = 12;
/** Numbers of a row of {@link knots}. */
export const KNOT_NUMBERS = 9;

/**
 * Rows of (kind, at, left, right, parent, before, after, weights of these two) of `span` + 1 samples; sample 0 is coded
 * only with `start`. `curved` ones are told against curves, others against lines.
 */
export function knots(span: number, start: boolean, curved: boolean): Int32Array {
  const none = [-1, -1, 0, 0];
  const rows: number[][] = start ? [[START!, 0, 0, 0, -1, ...none]] : [];
  rows.push([END!, span, 0, 0, start ? 0 : -1, ...none]);
  let intervals: [number, number, number][] = [[0, span, span]];
  while (intervals.length) {
    const below: [number, number, number][] = [];
    intervals.forEach(([left, right, parent], number) => {
      if (right - left < 2) return;
      const at = Math.floor((left + right) / 2);
      const [previous, next] = [intervals[number - 1], intervals[number + 1]];
      const before = curved && previous?.[1] === left ? previous[0] : -1;
      const after = curved && next?.[0] === right ? next[1] : -1;
      const weight = (of: number, other: number): number => weightOf(at, left, right, of, other);
      rows.push([MIDDLE!, at, left, right, parent, before, after, weight(before, after), weight(after, before)]);
      below.push([left, at, at], [at, right, at]);
    });
    intervals = below;
  }
  return Int32Array.from(rows.flat());
}

/** Lagrange's weight of the sample `of` between `left` and `right`; `other` is the fourth one. -1: there is none. */
function weightOf(at: number, left: number, right: number, of: number, other: number): number {
  if (of < 0) return 0;
  let share = (at - left) * (at - right);
  let whole = (of - left) * (of - right);
  if (other >= 0) [share, whole] = [share * (at - other), whole * (of - other)];
  if (whole < 0) [share, whole] = [-share, -whole];
  return Math.floor((share * 2 ** (WEIGHT_BITS + 1) + whole) / (2 * whole));
}

const MAGNITUDE = 63;
const EDGES = [0, 4, 9, 16, 28, 50, 100, 200, 440];
const UNKNOWN = 2;
const MOST_SPREAD = 756;
const SUMS = 3 * MAGNITUDE + MOST_SPREAD + 3 * 2 * MAGNITUDE + 1;
const WEIGHTS = 1 + 4 + 3;
export const CLASSES = EDGES.length + 1;

/** [8, 1324] class of a residual by what is known and what it tells. */
export function classTables(): Uint8Array {
  const out = new Uint8Array(WEIGHTS * SUMS).fill(UNKNOWN, 0, SUMS);
  for (let weight = 1; weight < WEIGHTS; weight++) {
    const edges = EDGES.map((edge) => Math.max(3 * weight * edge, 1));
    for (let sum = 0; sum < SUMS; sum++) out[weight * SUMS + sum] = edges.filter((edge) => edge <= 20 * sum).length;
  }
  return out;
}
