/** Vectors and rotations of a camera: +X right, +Y down, +Z forward; quaternions `wxyz`. */

import type { Quat, Vec3 } from "../seam.ts";

export const plus = (a: Vec3, b: Vec3, share = 1): Vec3 => [a[0] + b[0] * share, a[1] + b[1] * share, a[2] + b[2] * share];
export const minus = (a: Vec3, b: Vec3): Vec3 => plus(a, b, -1);
export const scaled = (a: Vec3, share: number): Vec3 => [a[0] * share, a[1] * share, a[2] * share];
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const length = (a: Vec3): number => Math.hypot(...a);
export const unit = (a: Vec3): Vec3 => scaled(a, 1 / (length(a) || 1));
export const clamp = (x: number, low: number, high: number): number => Math.min(Math.max(x, low), high);

/** Right, down and forward of a camera in the world. */
export type Axes = readonly [Vec3, Vec3, Vec3];

export function axesOf([w, x, y, z]: Quat): Axes {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

export function quaternionOf([r, d, f]: Axes): Quat {
  const trace = r[0] + d[1] + f[2];
  if (trace > 0) {
    const s = 2 * Math.sqrt(trace + 1);
    return canonical([s / 4, (d[2] - f[1]) / s, (f[0] - r[2]) / s, (r[1] - d[0]) / s]);
  }
  if (r[0] > d[1] && r[0] > f[2]) {
    const s = 2 * Math.sqrt(1 + r[0] - d[1] - f[2]);
    return canonical([(d[2] - f[1]) / s, s / 4, (d[0] + r[1]) / s, (f[0] + r[2]) / s]);
  }
  if (d[1] > f[2]) {
    const s = 2 * Math.sqrt(1 + d[1] - r[0] - f[2]);
    return canonical([(f[0] - r[2]) / s, (d[0] + r[1]) / s, s / 4, (f[1] + d[2]) / s]);
  }
  const s = 2 * Math.sqrt(1 + f[2] - r[0] - d[1]);
  return canonical([(r[1] - d[0]) / s, (f[0] + r[2]) / s, (f[1] + d[2]) / s, s / 4]);
}

/** `a` after `b`. */
export function product(a: Quat, b: Quat): Quat {
  return [
    a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
    a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
    a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
  ];
}

export const inverse = ([w, x, y, z]: Quat): Quat => [w, -x, -y, -z];

/** A vector turned by a unit quaternion. */
export function turned(q: Quat, v: Vec3): Vec3 {
  const [x, y, z] = axesOf(q);
  return plus(plus(scaled(x, v[0]), y, v[1]), z, v[2]);
}

/** By `angle` radians about a unit axis, right-handed. */
export function about(axis: Vec3, angle: number): Quat {
  const s = Math.sin(angle / 2);
  return [Math.cos(angle / 2), axis[0] * s, axis[1] * s, axis[2] * s];
}

/** Of length 1, with w >= 0. */
export function canonical(q: Quat): Quat {
  const size = Math.hypot(...q) * (q[0] < 0 ? -1 : 1) || 1;
  return [q[0] / size, q[1] / size, q[2] / size, q[3] / size];
}
