/** How cameras lie in the world, and a client's pixels in a reference. */

import type { Camera, Quat } from "../seam.ts";

export type Matrix3 = readonly [readonly number[], readonly number[], readonly number[]];

/** Rotation matrix, camera to world, of a unit quaternion `wxyz`. */
export function rotationMatrix([w, x, y, z]: Quat): Matrix3 {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** `(x z, y z, z) = D m (u, v, 1) + b` for a client's pixel (u, v) of depth D: the rows of m with b in the fourth. */
export interface Placement {
  readonly rows: readonly [number[], number[], number[]];
  /** Client pixels a reference pixel, at the images' centres. */
  readonly cellPx: readonly [number, number];
  /** Every how many pixels the client's view is sampled for what hides what. */
  readonly stride: number;
}

export function placementOf(client: Camera, reference: Camera): Placement {
  const { intrinsics: c } = client;
  const { intrinsics: r } = reference;
  const pinhole: Matrix3 = [[r.fxPx, 0, r.cxPx], [0, r.fyPx, r.cyPx], [0, 0, 1]];
  const inverse: Matrix3 = [[1 / c.fxPx, 0, -c.cxPx / c.fxPx], [0, 1 / c.fyPx, -c.cyPx / c.fyPx], [0, 0, 1]];
  const toReference = product(pinhole, transposed(rotationMatrix(reference.pose.rotation)));
  const m = product(product(toReference, rotationMatrix(client.pose.rotation)), inverse);
  const shift = client.pose.position.map((part, axis) => part - reference.pose.position[axis]);
  const b = toReference.map((row) => row[0] * shift[0] + row[1] * shift[1] + row[2] * shift[2]);
  const cellPx = [c.fxPx / r.fxPx, c.fyPx / r.fyPx] as const;
  return {
    rows: [[...m[0], b[0]], [...m[1], b[1]], [...m[2], b[2]]],
    cellPx,
    stride: Math.max(1, Math.floor(Math.min(...cellPx) / 2)),
  };
}

function transposed(m: Matrix3): Matrix3 {
  return [0, 1, 2].map((i) => [m[0][i], m[1][i], m[2][i]]) as unknown as Matrix3;
}

function product(a: Matrix3, b: Matrix3): Matrix3 {
  return a.map((row) =>
    [0, 1, 2].map((j) => row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]),
  ) as unknown as Matrix3;
}
