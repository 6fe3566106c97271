/** The window as a pinhole: how many pixels are drawn, and under which angles. */

import type { Intrinsics } from "../seam.ts";

/** Of the longer side. */
const FOV_RAD = Math.PI / 3;
/** Tangent of half the least angle of either side: servers draw no view of under half a degree. */
const LEAST_TAN = 0.005;
/** Smaller windows show nothing: they are folded away, or on their way to another size. */
const LEAST_PX = 16;
/** What every graphics processor takes in a picture's width and height. */
const MOST_SIDE_PX = 8192;
/** More are brought up by the browser: nobody sees them in motion. */
export const MOST_PIXELS = 2_100_000;

/** Tangents of half the angles of view. */
export interface Angles {
  readonly tanX: number;
  readonly tanY: number;
}

/** Width and height of a window that shows something. */
export function usableSize(width: number, height: number): [number, number] | undefined {
  return Math.min(width, height) < LEAST_PX ? undefined : [width, height];
}

/** Pixels of a window of this size, or of a picture of `fixed` ones. */
export function pixelsOf(width: number, height: number, ratio: number, fixed?: readonly [number, number]): [number, number] {
  const [x, y] = fixed ?? [width * ratio, height * ratio];
  const share = Math.min(1, Math.sqrt(MOST_PIXELS / (x * y)), MOST_SIDE_PX / Math.max(x, y));
  return [Math.max(LEAST_PX, Math.round(x * share)), Math.max(LEAST_PX, Math.round(y * share))];
}

/** The angles that a session begins with; in a very long window wider ones, for the short side's sake. */
export function anglesOf(width: number, height: number): Angles {
  const [longer, shorter] = [Math.max(width, height), Math.min(width, height)];
  const long = Math.max(Math.tan(FOV_RAD / 2), (LEAST_TAN * longer) / shorter);
  return width >= height ? { tanX: long, tanY: (long * height) / width } : { tanX: (long * width) / height, tanY: long };
}

/** A pinhole of these pixels that sees no more than `session`, for which the server makes its references. */
export function intrinsicsOf(width: number, height: number, session: Angles): Intrinsics {
  const tanX = Math.min(session.tanX, (session.tanY * width) / height);
  const focal = width / (2 * tanX);
  return { widthPx: width, heightPx: height, fxPx: focal, fyPx: focal, cxPx: width / 2, cyPx: height / 2 };
}
