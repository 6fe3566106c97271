/** Where splats that changed lie in a view; whether anything hides them there, the device tells by its depth. */

import { rotationMatrix } from "../gpu/camera.ts";
import { VETO_CELL_PX } from "../gpu/layout.ts";
import type { Camera } from "../seam.ts";

/**
 * Cells of 16 x 16 pixels that spheres at `positions` [n, 3] of `radii` [n] may cover, as `changed.wgsl` takes them [m, 4]:
 * first and last row, then column, in 16 bits each; bits of the near side's depth; 0. As `cags_common.correction.cell_boxes`.
 */
export function cellBoxes(positions: Float32Array, radii: Float32Array, camera: Camera): Uint32Array<ArrayBuffer> {
  const { widthPx, heightPx, fxPx, fyPx, cxPx, cyPx } = camera.intrinsics;
  const [rows, columns] = [Math.ceil(heightPx / VETO_CELL_PX), Math.ceil(widthPx / VETO_CELL_PX)];
  const toWorld = rotationMatrix(camera.pose.rotation);
  const at = camera.pose.position;
  const out = new Uint32Array(4 * radii.length);
  const depths = new Float32Array(out.buffer);
  let count = 0;
  for (let k = 0; k < radii.length; k++) {
    const away = [0, 1, 2].map((axis) => positions[3 * k + axis] - at[axis]);
    const [x, y, z] = [0, 1, 2].map((axis) => away[0] * toWorld[0][axis] + away[1] * toWorld[1][axis] + away[2] * toWorld[2][axis]);
    const radius = radii[k];
    if (!(radius > 0) || !(z + radius > camera.near)) continue;
    const near = Math.max(z - radius, camera.near);
    const down = span(y, radius, near, z, fyPx, cyPx, rows);
    const across = span(x, radius, near, z, fxPx, cxPx, columns);
    if (down === undefined || across === undefined) continue;
    out.set([down, across], 4 * count);
    depths[4 * count + 2] = near;
    count++;
  }
  return out.slice(0, 4 * count);
}

/** First and last cell of a sphere along one axis, in 16 bits each; undefined where it lies outside. */
function span(at: number, radius: number, near: number, z: number, focal: number, centre: number, cells: number): number | undefined {
  const [low, high] = [at - radius, at + radius];
  const first = Math.floor((Math.min(low / near, low / (z + radius)) * focal + centre) / VETO_CELL_PX);
  const last = Math.floor((Math.max(high / near, high / (z + radius)) * focal + centre) / VETO_CELL_PX);
  if (!(last >= 0 && first < cells)) return undefined;
  return Math.max(first, 0) | (Math.min(last, cells - 1) << 16);
}
