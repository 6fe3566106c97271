/**
 * What a player of a published folder fetches next, decided from the index alone: pure, so that it can be tested.
 *
 * First the base of every frame up to the horizon, in order: without it nothing is shown. Then, while that is far enough
 * ahead, levels of what is in view, by what a byte of them gains.
 */
import type { FrameEntry, TileEntry } from "./bundleIndex.ts";

/** Levels `from` .. `to` - 1 of a tile. */
export interface Wish {
  readonly entry: TileEntry;
  readonly from: number;
  readonly to: number;
}

/** Bytes `start` .. `end` - 1 of a group's file, and what lies there: levels of tiles, and removed ids of frames. */
export interface Range {
  readonly start: number;
  readonly end: number;
  readonly wishes: readonly Wish[];
  readonly removed: readonly FrameEntry[];
}

/** Gaps that are fetched along: a request costs about as much. */
const GAP_BYTES = 2048;
const RANGE_BYTES = 256 << 10;
const BATCH_FRAMES = 10;
const BATCH_BYTES = 48 << 10;
const OUT_OF_VIEW = 0.02;

/** Of what is sent with the base of a frame: all of motion and of updates, the lowest level of looks. */
export function baseWishes(frame: FrameEntry): Wish[] {
  return frame.tiles.map((entry) => ({ entry, from: 0, to: entry.kind === "looks" ? 1 : entry.crcs.length }));
}

/** How a level counts: by the gain that was measured, else by halves. */
export function levelGain(gainsDb: readonly number[], level: number): number {
  return gainsDb.length ? Math.max(gainsDb[level - 1] ?? 0, 0.01) : 0.5 ** (level / 8);
}

/** Further levels of looks, the best first, of about `bytes` bytes. `held` tells how many levels of a tile are there or
 * under way; `inView` whether a tile is seen. */
export function refinements(
  looks: readonly TileEntry[], held: (entry: TileEntry) => number, inView: (entry: TileEntry) => boolean,
  gainsDb: readonly number[], bytes: number,
): Wish[] {
  const next = new Map(looks.map((entry) => [entry, held(entry)]));
  const worth = (entry: TileEntry): number => {
    const level = next.get(entry)!;
    if (level < 1 || level >= entry.crcs.length) return 0;
    const size = entry.offsets[level + 1]! - entry.offsets[level]! + 16;
    return (levelGain(gainsDb, level) * entry.splats * (inView(entry) ? 1 : OUT_OF_VIEW)) / size;
  };
  const queue = looks.map((entry) => ({ entry, worth: worth(entry) })).filter((item) => item.worth > 0);
  const from = new Map<TileEntry, number>();
  let left = bytes;
  while (queue.length && left > 0) {
    let best = 0;
    for (let i = 1; i < queue.length; i++) if (queue[i]!.worth > queue[best]!.worth) best = i;
    const { entry } = queue[best]!;
    const level = next.get(entry)!;
    if (!from.has(entry)) from.set(entry, level);
    left -= entry.offsets[level + 1]! - entry.offsets[level]!;
    next.set(entry, level + 1);
    queue[best]!.worth = worth(entry);
    if (!queue[best]!.worth) queue.splice(best, 1);
  }
  return [...from].map(([entry, first]) => ({ entry, from: first, to: next.get(entry)! }));
}

/** Requests for `wishes` of one group, and for the removed ids of `frames`; neighbours together. */
export function ranges(wishes: readonly Wish[], frames: readonly FrameEntry[] = []): Range[] {
  const places = [
    ...wishes.map((wish) => ({ start: wish.entry.offsets[wish.from]!, end: wish.entry.offsets[wish.to]!, wishes: [wish], removed: [] })),
    ...frames.map((frame) => ({ start: frame.removed[0], end: frame.removed[1], wishes: [], removed: [frame] })),
  ].filter(({ start, end }) => end > start).sort((a, b) => a.start - b.start);
  const out: { start: number; end: number; wishes: Wish[]; removed: FrameEntry[] }[] = [];
  for (const place of places) {
    const last = out.at(-1);
    if (last && place.start - last.end <= GAP_BYTES && place.end - last.start <= RANGE_BYTES) {
      last.end = Math.max(last.end, place.end);
      last.wishes.push(...place.wishes);
      last.removed.push(...place.removed);
    } else out.push({ ...place, wishes: [...place.wishes], removed: [...place.removed] });
  }
  return out;
}

/** Of `frames`, from the first on: those whose bases are asked for in one go. */
export function batch(frames: readonly FrameEntry[]): FrameEntry[] {
  const out: FrameEntry[] = [];
  let bytes = 0;
  for (const frame of frames) {
    if (out.length >= BATCH_FRAMES || bytes >= BATCH_BYTES) break;
    out.push(frame);
    for (const { entry, from, to } of baseWishes(frame)) bytes += entry.offsets[to]! - entry.offsets[from]!;
  }
  return out;
}
