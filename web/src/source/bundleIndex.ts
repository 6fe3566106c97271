/** The index at the end of a group's file, as `cags_common.bundle.index`: where every payload lies, and its CRC-32. */
import { BundleError, DecodeError } from "../bytes/errors.ts";
import { gunzip } from "../bytes/inflate.ts";
import { LEVELS } from "../motion/chunk.ts";
import type { Sphere } from "../store/storedTiles.ts";
import { MAX_TILE_SPLATS } from "../decode/tiles.ts";

const MAX_INDEX_BYTES = 64 * 2 ** 20;
const MAGIC_BYTES = 8;
const [HEADER_BYTES, FRAME_BYTES, TILE_BYTES] = [16, 16, 42];
const [LOOKS, MOTION, UPDATE] = [0, 1, 2];

export interface TileEntry {
  readonly frame: number;
  readonly tile: number;
  readonly kind: "looks" | "motion" | "update";
  readonly splats: number;
  /** A ball that holds the tile's means. */
  readonly sphere: Sphere;
  /** Media frames from its first for which it says something: of motion its span; others hold to the group's end. */
  readonly span: number;
  /** Where the payload of each level begins in the file; one more at the end. */
  readonly offsets: readonly number[];
  readonly crcs: readonly number[];
}

export interface FrameEntry {
  readonly frame: number;
  /** Where the removed ids lie. */
  readonly removed: readonly [number, number];
  readonly removedCrc: number;
  readonly tiles: readonly TileEntry[];
}

/** Read the index of the group that begins at media frame `first`. Raises {@link BundleError}. */
export function readIndex(data: Uint8Array, first: number, count: number, lods: number, what: string): FrameEntry[] {
  const raw = unpacked(data, what);
  const view = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
  const numbers = raw.length < HEADER_BYTES ? [] : [0, 4, 8, 12].map((at) => view.getUint32(at, true));
  const tiles = numbers[3] ?? 0;
  if (numbers[0] !== first || numbers[1] !== count || numbers[2] !== lods) throw new BundleError(`${what}: is not this group's`);
  const columns = Math.max(lods, LEVELS); // motion may have more levels than looks have LoDs
  if (raw.length !== HEADER_BYTES + count * FRAME_BYTES + tiles * (TILE_BYTES + 8 * columns)) {
    throw new BundleError(`${what}: has ${raw.length} bytes, which is another length`);
  }
  return frames(view, first, count, tiles, [lods, columns], what);
}

function unpacked(data: Uint8Array, what: string): Uint8Array {
  try {
    return gunzip(data, MAX_INDEX_BYTES, what);
  } catch (error) {
    throw error instanceof DecodeError ? new BundleError(error.message) : error;
  }
}

function frames(
  view: DataView, first: number, count: number, tiles: number, [lods, columns]: readonly [number, number], what: string,
): FrameEntry[] {
  const tileAt = HEADER_BYTES + count * FRAME_BYTES;
  const sizesAt = tileAt + tiles * TILE_BYTES;
  const out: FrameEntry[] = [];
  let offset = MAGIC_BYTES;
  let row = 0;
  for (let index = 0; index < count; index++) {
    const [own, , bytes, removedCrc] = [0, 4, 8, 12].map((k) => view.getUint32(HEADER_BYTES + FRAME_BYTES * index + k, true));
    if (row + own! > tiles) throw new BundleError(`${what}: tile counts do not add up`);
    const removed = [offset, (offset += bytes!)] as const;
    const entries: TileEntry[] = [];
    for (let tile = 0; tile < own!; tile++, row++) {
      const at = [tileAt + TILE_BYTES * row, sizesAt + 4 * columns * row, tiles * columns * 4] as const;
      const entry = tileEntry(view, first + index, tile, at, lods, offset, what);
      offset = entry.offsets.at(-1)!;
      entries.push(entry);
    }
    out.push({ frame: first + index, removed, removedCrc: removedCrc!, tiles: entries });
  }
  if (row !== tiles) throw new BundleError(`${what}: tile counts do not add up`);
  return out;
}

function tileEntry(
  view: DataView, frame: number, tile: number, [at, sizesAt, crcsAfter]: readonly [number, number, number],
  lods: number, offset: number, what: string,
): TileEntry {
  const [kind, span, splats] = [view.getUint8(at), view.getUint8(at + 1), view.getUint32(at + 10, true)];
  if (kind > UPDATE! || (kind === MOTION) !== span > 0 || splats > MAX_TILE_SPLATS) {
    throw new BundleError(`${what}: kind ${kind}, span ${span}, ${splats} splats of tile ${tile} are outside the bounds`);
  }
  const levels = kind === MOTION ? LEVELS : lods;
  const offsets = [offset];
  const crcs: number[] = [];
  for (let level = 0; level < levels; level++) {
    offsets.push(offsets[level]! + view.getUint32(sizesAt + 4 * level, true));
    crcs.push(view.getUint32(sizesAt + crcsAfter + 4 * level, true));
  }
  const corner = (k: number): number => view.getFloat32(at + 18 + 4 * k, true);
  const middle = (k: number): number => (corner(k) + corner(k + 3)) / 2;
  const radius = Math.hypot(corner(3) - corner(0), corner(4) - corner(1), corner(5) - corner(2)) / 2;
  const named = kind === LOOKS ? "looks" : kind === MOTION ? "motion" : "update";
  return { frame, tile, kind: named, splats, sphere: [middle(0), middle(1), middle(2), radius], span, offsets, crcs };
}
