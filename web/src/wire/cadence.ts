/** Which media frames a client displays that cannot draw them all, as `cags_protocol.cadence`. */
export const EVERY_FRAME = 1000;
export const LEAST_PERMILLE = 250;

/** The first frame that is displayed from `number` on. */
export function nextDisplayed(number: number, permille: number): number {
  const level = Math.floor(((number - 1) * permille) / EVERY_FRAME) + 1;
  return Math.ceil((level * EVERY_FRAME) / permille);
}

/** The last frame that is displayed up to `number`, which is not negative. */
export function lastDisplayed(number: number, permille: number): number {
  const level = Math.floor((number * permille) / EVERY_FRAME);
  return Math.ceil((level * EVERY_FRAME) / permille);
}
