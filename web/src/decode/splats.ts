/** Splats as columns, and what they are made of: attributes, each a small vector a splat, coded by itself. */

export const SH_REST_OF_DEGREE = [0, 3, 8, 15] as const;

/** Columns of n splats, rows one after another; the names are those of `cags_common.splats.Splats`. */
export interface Splats {
  readonly means: Float32Array; // [n, 3] world, metres
  readonly quats: Float32Array; // [n, 4] wxyz, unit, w >= 0
  readonly log_scales: Float32Array; // [n, 3]
  readonly logit_opacities: Float32Array; // [n]
  readonly sh0: Float32Array; // [n, 3]
  readonly sh_rest: Float32Array; // [n, K, 3]
}

export type Column = keyof Splats;

/** Every attribute and its dimension, in the order in which they are coded and numbered. */
export const ATTRIBUTE_DIMS: ReadonlyMap<string, number> = new Map([
  ["scale", 3], ["rotation_real", 1], ["rotation_imag", 3], ["rotation", 3], ["opacity", 1], ["alpha", 1],
  ["sh0", 3], ["sh1", 9], ["sh2", 15], ["sh3", 21],
]);

export const SH_REST_ATTRIBUTES = ["sh1", "sh2", "sh3"] as const;

/** Numbers a row of each column but `sh_rest`. */
export const WIDTHS = { means: 3, quats: 4, log_scales: 3, logit_opacities: 1, sh0: 3 } as const;

const fround = Math.fround;
const LEAST_ALPHA = fround(1e-4);
const MOST_ALPHA = fround(1 - 1e-4);

/** The opacity logit of a drawn opacity, kept inside (0, 1). */
export function alphaLogit(alpha: number): number {
  const inside = Math.min(Math.max(alpha, LEAST_ALPHA), MOST_ALPHA);
  return fround(Math.log(fround(inside / fround(1 - inside))));
}
