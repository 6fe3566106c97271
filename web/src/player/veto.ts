/** Where a view shows splats that changed: what a reference says about them is not true any more. */

import { rotationMatrix } from "../gpu/camera.ts";
import { VETO_CELL_PX } from "../gpu/layout.ts";
import type { Camera } from "../seam.ts";

/**
 * 1 for cells of 16 x 16 pixels [ceil(H / 16), ceil(W / 16)] in which a changed splat may be seen, else 0.
 *
 * As `cags_common.correction.changed_cells`, but for what hides what: the depth of a frame is not read back, so changed
 * splats count as seen wherever they lie.
 */
export function changedCells(positions: Float32Array, radii: Float32Array, camera: Camera): Float32Array<ArrayBuffer> {
  const { widthPx, heightPx, fxPx, fyPx, cxPx, cyPx } = camera.intrinsics;
  const [rows, columns] = [Math.ceil(heightPx / VETO_CELL_PX), Math.ceil(widthPx / VETO_CELL_PX)];
  const veto = new Float32Array(rows * columns);
  const toWorld = rotationMatrix(camera.pose.rotation);
  const at = camera.pose.position;
  for (let k = 0; k < radii.length; k++) {
    const away = [0, 1, 2].map((axis) => positions[3 * k + axis] - at[axis]);
    const [x, y, z] = [0, 1, 2].map((axis) => away[0] * toWorld[0][axis] + away[1] * toWorld[1][axis] + away[2] * toWorld[2][axis]);
    const radius = radii[k];
    if (!(radius > 0) || z + radius <= camera.near) continue;
    const near = Math.max(z - radius, camera.near);
    const [top, bottom] = span(y, radius, near, z, fyPx, cyPx, rows);
    const [left, right] = span(x, radius, near, z, fxPx, cxPx, columns);
    for (let row = top; row <= bottom; row++) veto.fill(1, row * columns + left, row * columns + Math.max(right + 1, left));
  }
  return veto;
}

/** First and last cell of a sphere along one axis; none where the last is before the first. */
function span(at: number, radius: number, near: number, z: number, focal: number, centre: number, cells: number): [number, number] {
  const [low, high] = [at - radius, at + radius];
  const first = Math.min(low / near, low / (z + radius)) * focal + centre;
  const last = Math.max(high / near, high / (z + radius)) * focal + centre;
  return [Math.max(Math.floor(first / VETO_CELL_PX), 0), Math.min(Math.floor(last / VETO_CELL_PX), cells - 1)];
}

/** The veto of a reference that fades, over one of what changed. */
export function fadedVeto(veto: Float32Array<ArrayBuffer> | undefined, freshness: number, { intrinsics }: Camera): Float32Array<ArrayBuffer> | undefined {
  if (freshness >= 1) return veto;
  const cells = Math.ceil(intrinsics.heightPx / VETO_CELL_PX) * Math.ceil(intrinsics.widthPx / VETO_CELL_PX);
  return (veto ?? new Float32Array(cells)).map((part) => Math.max(part, 1 - freshness));
}
