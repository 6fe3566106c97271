/** The window as a pinhole: how many pixels are drawn, and under which angles. */

import type { Intrinsics } from "../seam.ts";

/** Of the longer side. */
const FOV_RAD = Math.PI / 3;
/** More are brought up by the browser: nobody sees them in motion. */
export const MOST_PIXELS = 2_100_000;

/** Tangents of half the angles of view. */
export interface Angles {
  readonly tanX: number;
  readonly tanY: number;
}

/** Pixels of a window of this size. */
export function pixelsOf(width: number, height: number, ratio: number, fixed?: readonly [number, number]): [number, number] {
  if (fixed) return [fixed[0], fixed[1]];
  const [x, y] = [Math.max(width, 1) * ratio, Math.max(height, 1) * ratio];
  const share = Math.min(1, Math.sqrt(MOST_PIXELS / (x * y)));
  return [Math.max(16, Math.round(x * share)), Math.max(16, Math.round(y * share))];
}

/** The angles that a session begins with. */
export function anglesOf(width: number, height: number): Angles {
  const long = Math.tan(FOV_RAD / 2);
  return width >= height ? { tanX: long, tanY: (long * height) / width } : { tanX: (long * width) / height, tanY: long };
}

/** A pinhole of these pixels that sees no more than `session`, for which the server makes its references. */
export function intrinsicsOf(width: number, height: number, session: Angles): Intrinsics {
  const tanX = Math.min(session.tanX, (session.tanY * width) / height);
  const focal = width / (2 * tanX);
  return { widthPx: width, heightPx: height, fxPx: focal, fyPx: focal, cxPx: width / 2, cyPx: height / 2 };
}
