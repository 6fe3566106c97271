/** A tile by media frame and number, as one number that sorts by both. */
export type Key = number;

const TILES = 2 ** 16;

export function keyOf(frame: number, tile: number): Key {
  return frame * TILES + tile;
}

/** Of looks that a payload names: numbers beyond those of tiles are keys of none. */
export function looksKey(frame: number, tile: number): Key {
  return tile < TILES ? keyOf(frame, tile) : -(tile * 2 ** 20 + (frame % 2 ** 20));
}

export function frameOf(key: Key): number {
  return Math.floor(key / TILES);
}

export function tileOf(key: Key): number {
  return key % TILES;
}

/** The tile in an error. */
export function named(key: Key): string {
  return `tile ${tileOf(key)} of frame ${frameOf(key)}`;
}
