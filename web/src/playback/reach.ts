/** How far a reference holds from its own camera; as `cags_common.correction.reach`. */
import { inverse, length, minus, product } from "../player/vectors.ts";
import type { Pose, Vec3 } from "../seam.ts";

/** Mean squared difference, RGB from 0 to 1, up to which one is small; from twice as much on it is large. */
const SMALL = 10 ** -4.4;

/** Share of a small difference that is lost per radian. */
const SMALL_FADES = 2.5;

/** A large difference holds up to this distance, radians, and beyond it loses so much of itself per radian. */
const LARGE_HOLDS = 0.2;
const LARGE_FADES = 2;

/** How far apart two views of a scene are, radians: turned, and stepped aside as seen from the scene's focus. */
export function apart(a: Pose, b: Pose, centre: Vec3, radius: number): number {
  const away = Math.max(length(minus(b.position, centre)), radius);
  const [w, ...axis] = product(inverse(a.rotation), b.rotation);
  return 2 * Math.atan2(length(axis), Math.abs(w)) + length(minus(a.position, b.position)) / away;
}

/** From 1 for small differences to 0 for large ones and those of an unknown mean square (0). */
export function smallness(meanSquare: number): number {
  return meanSquare > 0 ? Math.min(Math.max(2 - meanSquare / SMALL, 0), 1) : 0;
}

/** Share from 0 to 1 of a reference to use at `distance` from its camera; pictures are of no smallness. */
export function validShare(distance: number, small: number): number {
  const ofSmall = Math.max(1 - SMALL_FADES * distance, 0);
  const ofLarge = Math.min(Math.max(1 - LARGE_FADES * (distance - LARGE_HOLDS), 0), 1);
  return small * ofSmall + (1 - small) * ofLarge;
}
