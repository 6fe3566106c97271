/** How far a difference holds from its own camera; as `cags_common.correction.reach`. */
import { inverse, length, minus, product } from "../player/vectors.ts";
import type { Pose, Vec3 } from "../seam.ts";

/** Share that is lost per radian beyond a difference's reach. */
const FADES = 2.5;

/** How far apart two views of a scene are, radians: turned, and stepped aside as seen from the scene's focus. */
export function apart(a: Pose, b: Pose, centre: Vec3, radius: number): number {
  const away = Math.max(length(minus(b.position, centre)), radius);
  const [w, ...axis] = product(inverse(a.rotation), b.rotation);
  return 2 * Math.atan2(length(axis), Math.abs(w)) + length(minus(a.position, b.position)) / away;
}

/** Share from 0 to 1 of a difference to use at `distance` from its camera. */
export function validShare(distance: number, reach: number): number {
  return Math.min(Math.max(1 - FADES * (distance - reach), 0), 1);
}
