/** How far a picture is believed where the client's own splats are better; as `cags_common.correction.trust`. */

const MOST_DOUBTED = 0.01;
const LEAST_POWER = 1e-9;

/**
 * The error to assume for a picture of an earlier frame whose coding left `error`, where the splats are expected to have
 * `ownError` (NaN: unknown); mean squares of RGB from 0 to 1. Splats that are better than the picture differ from it because
 * some are missing or because the scene has moved on: then only large differences count.
 */
export function doubted(error: number, ownError: number): number {
  if (!(ownError >= 0 && ownError < error)) return error;
  const octaves = Math.round(Math.log2(error / Math.max(ownError, LEAST_POWER)));
  return Math.max(error, Math.min(error * 2 ** octaves, MOST_DOUBTED));
}
