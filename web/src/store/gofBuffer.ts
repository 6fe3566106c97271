/**
 * What is held of one group of frames; as `cags_common.store.gof_buffer`. Tiles are decoded when they arrive;
 * {@link GofBuffer.commit} makes them visible, all of a frame's at once. What is shown depends on what came up to a mark
 * and on the frame alone.
 */
import type { DecodeError } from "../bytes/errors.ts";
import type { Opener } from "./opener.ts";
import { gofRange, type Manifest } from "../decode/manifest.ts";
import { LEVELS } from "../motion/chunk.ts";
import type { Camera } from "../seam.ts";
import type { HeldTile } from "../wire/messages.ts";
import { fovRad, worldToCamera } from "../wire/geometry.ts";
import { type Arrival, GofTiles } from "./gofTiles.ts";
import type { StoredLooks, StoredMotion, StoredUpdate, Staged } from "./storedTiles.ts";
import { frameOf, type Key } from "./keys.ts";
import { SplatBuffer } from "./splatBuffer.ts";

/** What a commit did: rows that changed, the media frame of the newest tile or end of a splat that changed each, further
 * rows that only moved, and whether the end of the frame was there. */
export interface Changes {
  readonly rows: Int32Array;
  readonly began: Int32Array;
  readonly moved: Int32Array;
  readonly whole: boolean;
}

/** The end of a frame, and the last mark that came before it. */
interface End {
  readonly mark: number;
  readonly removed: Int32Array;
}

export class GofBuffer {
  /** Whether the end of the frame on display had come when it was committed. */
  whole = false;
  /** Whether looks of any frame up to the one on display have been shown. */
  begun = false;
  readonly buffer: SplatBuffer;
  private readonly manifest: Manifest;
  private readonly gof: number;
  private readonly codec: Opener;
  private tiles: GofTiles;
  private readonly shown: StoredLooks[] = [];
  private readonly coarse = new Map<Key, StoredMotion | StoredUpdate>(); // shown below its highest level
  private frame = -1;
  private horizon = -1;
  private rewound = false;
  private resting = false;
  private ends = new Set<number>(); // not yet shown
  private readonly ended = new Map<number, End>();

  /** `mark` is the last that came. */
  constructor(manifest: Manifest, gof: number, codec: Opener, mark: number) {
    this.manifest = manifest;
    this.gof = gof;
    this.codec = codec;
    const capacity = manifest.capacity[gof]!;
    this.buffer = new SplatBuffer(codec.kernels, capacity, manifest.shDegree, (slot) => this.onReplaced(slot));
    const range = gofRange(manifest, gof);
    this.tiles = new GofTiles({ range, capacity, codec, inMotion: manifest.motion !== undefined, mark });
  }

  /** Free the splats; nothing may be shown after it. */
  dispose(): void {
    this.buffer.dispose();
  }

  /** Another store, of so many LoDs of each tile (undefined: of what {@link held} says), without ends of frames. */
  resumed(inventory: ReadonlyMap<Key, number> | undefined): GofBuffer {
    const other = new GofBuffer(this.manifest, this.gof, this.codec, this.tiles.mark);
    other.tiles = this.tiles.resumed(inventory);
    return other;
  }

  get keeps(): boolean {
    return this.tiles.keeps;
  }

  /** Splats held for a replay alone; motion and updates count as the splats that take as much memory. */
  get keptSplats(): number {
    return this.tiles.keptSplats;
  }

  // ------------------------------------------------------------------------------------------------------------ arrival

  add(arrivals: readonly Arrival[]): DecodeError[] {
    return this.tiles.add(arrivals);
  }

  flush(): DecodeError[] {
    return this.tiles.flush();
  }

  /** What comes from now on belongs to later marks. After {@link flush}. */
  mark(number: number): void {
    this.tiles.mark = number;
  }

  takeDropped(): HeldTile[] {
    return this.tiles.takeDropped();
  }

  /** Nothing more is planned for `frame`; `removed` ids end there. Raises {@link DecodeError}. */
  end(frame: number, removed: Int32Array): void {
    this.tiles.checkIds(removed, `removed ids of frame ${frame}`);
    if (this.ended.has(frame)) return;
    this.ended.set(frame, { mark: this.tiles.mark, removed });
    this.ends.add(frame);
  }

  // ------------------------------------------------------------------------------------------------------------ display

  /** Show what has come up to mark `basis` (undefined: everything) for frames up to `frame`, where it is then. */
  commit(frame: number, basis?: number): Changes {
    const limit = basis ?? Infinity;
    const horizon = this.newestEnd(frame, limit);
    if (frame < this.frame || this.resting) this.rewind(horizon, limit);
    this.frame = frame;
    this.horizon = Math.max(this.horizon, horizon);
    const ends = this.due(horizon, limit);
    this.whole = this.horizon >= frame && this.ended.has(frame);
    this.tiles.stage(horizon, horizon);
    const updates = this.tiles.due(horizon, limit);
    const touched = new Uint8Array(this.buffer.capacity); // 1: changed, 2: only moved
    const began = new Int32Array(this.buffer.capacity);
    const change = (rows: Iterable<number>, since: number): void => {
      for (const row of rows) {
        touched[row] = 1;
        if (began[row]! < since) began[row] = since;
      }
    };
    if (this.rewound) touched.fill(1);
    this.rewound = false;
    for (const [f, { removed }] of ends) change(this.buffer.remove(f, removed), f);
    for (const staged of updates) change(this.show(staged, frame), frameOf(staged.held.key));
    this.buffer.ramp(frame, (row, since) => change([row], since));
    for (const rows of this.buffer.move(frame)) for (const row of rows) touched[row] ||= 2;
    this.forgetPast(frame, updates.length + ends.length > 0);
    const rows = where(touched, 1);
    return { rows, began: rows.map((row) => began[row]!), moved: where(touched, 2), whole: this.whole };
  }

  /** Another group is on display: free the splats until the next {@link commit}, which replays held tiles. */
  rest(): void {
    if (this.frame < 0 || this.resting) return;
    this.buffer.dispose();
    this.resting = true;
  }

  /** Show the splats on display where they are at `time`, after the frame that was committed; the rows that moved. */
  move(time: number): Int32Array {
    return gathered(this.buffer.move(time), this.buffer.capacity);
  }

  /** The rows that change by it at `time`; nothing moves before all of it is applied. */
  private show(staged: Staged, time: number): Iterable<number> {
    if ("splats" in staged) return this.showLooks(staged);
    const { held } = staged;
    held.shownLod = staged.lod;
    let top = LEVELS - 1;
    let rows: Iterable<number> = [];
    if ("values" in staged) {
      staged.held.idsOf = new Map([...staged.values].map(([column, { ids }]) => [column, ids]));
      top = this.manifest.lods - 1;
      rows = this.buffer.update(frameOf(held.key), staged.values, time);
    } else if (staged.held.versions) {
      this.buffer.setMotion(staged.held.looks, frameOf(held.key), staged.chunk);
    }
    if (staged.lod < top) this.coarse.set(held.key, held);
    else this.coarse.delete(held.key);
    return rows;
  }

  private showLooks({ held, lod, ids, splats, steps }: Extract<Staged, { held: StoredLooks }>): Int32Array {
    held.steps = steps;
    this.begun ||= ids.length > 0;
    if (held.index < 0) {
      held.index = this.buffer.slots.length;
      this.buffer.add(held);
      this.shown.push(held);
    }
    return this.buffer.write(held, lod, ids, splats);
  }

  /** The newest frame up to `frame` whose end came before mark `limit`; -1 where none did. */
  private newestEnd(frame: number, limit: number): number {
    let newest = -1;
    for (const [f, end] of this.ended) if (f <= frame && end.mark < limit && f > newest) newest = f;
    return newest;
  }

  /** Removals to be shown, of frames up to `horizon` whose ends came before mark `limit`. */
  private due(horizon: number, limit: number): (readonly [number, End])[] {
    const frames = [...this.ends].filter((f) => f <= horizon && this.ended.get(f)!.mark < limit).sort((a, b) => a - b);
    for (const f of frames) this.ends.delete(f);
    return frames.map((f) => [f, this.ended.get(f)!] as const);
  }

  /** Back to an empty picture; everything held waits to be shown again, in order. */
  private rewind(horizon: number, limit: number): void {
    this.buffer.clear();
    for (const looks of this.tiles.rewind(horizon, limit)) this.buffer.dropMotion(looks);
    this.coarse.clear();
    this.ends = new Set(this.ended.keys());
    this.rewound = true;
    this.resting = this.begun = false;
    this.horizon = -1;
  }

  /** Nothing of a tile is shown any more. */
  private onReplaced(slot: StoredLooks): void {
    if (slot.replaced) return;
    this.buffer.dropMotion(slot.key);
    for (const held of this.tiles.replaced(slot)) this.coarse.delete(held.key);
  }

  /** Chunks of motion that later ones followed; once nothing is kept, updates too of which nothing is left. */
  private forgetPast(frame: number, changed: boolean): void {
    for (const held of this.tiles.past(this.buffer.dropPast(frame))) this.coarse.delete(held.key);
    if (!changed || this.keeps) return;
    for (const update of this.tiles.updates()) {
      if (this.buffer.uses(frameOf(update.key), update.idsOf)) continue;
      this.tiles.forget(update);
      this.coarse.delete(update.key);
    }
  }

  /** The frame on display; -1 before any. */
  get shownFrame(): number {
    return this.frame;
  }

  /** The newest frame that has come whole; -1 before any. */
  get newest(): number {
    return Math.max(-1, ...this.ended.keys());
  }

  /** Whether `frame` can be shown whole at once. */
  holds(frame: number): boolean {
    return this.tiles.keeps && this.ended.has(frame);
  }

  // ------------------------------------------------------------------------------------------------------------ figures

  held(): HeldTile[] {
    return this.tiles.held();
  }

  /** Whether everything shown is at its highest LoD, motion and updates too. */
  get full(): boolean {
    const top = this.manifest.lods - 1;
    if (this.shown.some((tile) => tile.onDisplay && tile.shownLod !== top)) return false;
    return ![...this.coarse.values()].some((held) => this.counts(held));
  }

  /** Whether `held` makes anything that is shown what it is. */
  private counts(held: StoredMotion | StoredUpdate): boolean {
    if (held.kind === "update") return this.buffer.uses(frameOf(held.key), held.idsOf, true);
    const looks = this.tiles.looks(held.looks);
    return looks !== undefined && looks.onDisplay && this.buffer.moves(held.looks) === frameOf(held.key);
  }

  /**
   * Of the shown splats of tiles whose bounding sphere meets the view: their mean LoD, and the mean squared error that they
   * are expected to have, RGB from 0 to 1. NaN where there are none.
   */
  detailIn(camera: Camera): { readonly lod: number; readonly error: number } {
    let [weights, lods, errors] = [0, 0, 0];
    const meets = viewCone(camera);
    for (const tile of this.shown) {
      if (!tile.onDisplay || tile.shownLod < 0 || !meets(tile.sphere)) continue;
      weights += tile.owned;
      lods += tile.owned * tile.shownLod;
      errors += tile.owned * this.manifest.lodErrors[tile.shownLod]!;
    }
    return { lod: lods / weights, error: errors / weights };
  }
}

/** Tells which spheres meet the cone around a view's pyramid. */
export function viewCone(camera: Camera): (sphere: readonly [number, number, number, number]) => boolean {
  const { rotation, translation } = worldToCamera(camera.pose);
  const [fovX, fovY] = fovRad(camera.intrinsics);
  const half = Math.atan(Math.hypot(Math.tan(fovX / 2), Math.tan(fovY / 2)));
  return ([x, y, z, radius]) => {
    const at = (i: number): number => rotation[i]! * x + rotation[i + 1]! * y + rotation[i + 2]! * z;
    const [px, py, pz] = [at(0) + translation[0], at(3) + translation[1], at(6) + translation[2]];
    const distance = Math.max(Math.hypot(px, py, pz), 1e-9);
    const angle = Math.acos(Math.min(Math.max(pz / distance, -1), 1));
    return angle <= half + Math.asin(Math.min(radius / distance, 1)) || distance <= radius;
  };
}

function where(flags: Uint8Array, wanted: number): Int32Array {
  const out = new Int32Array(flags.length);
  let count = 0;
  for (let i = 0; i < flags.length; i++) if (flags[i] === wanted) out[count++] = i;
  return out.slice(0, count);
}

/** Rows of several tiles, no row of two of them, each tile's ascending: all of them, ascending. */
function gathered(parts: readonly Int32Array[], capacity: number): Int32Array {
  if (parts.length === 1) return parts[0]!;
  const out = new Int32Array(parts.reduce((sum, rows) => sum + rows.length, 0));
  let [count, ascending] = [0, true];
  for (const rows of parts) {
    if (count && rows.length && rows[0]! < out[count - 1]!) ascending = false;
    out.set(rows, count);
    count += rows.length;
  }
  if (ascending) return out;
  const flags = new Uint8Array(capacity);
  for (let i = 0; i < count; i++) flags[out[i]!] = 1;
  return where(flags, 1);
}
