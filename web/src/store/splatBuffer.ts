/**
 * The splats of one group of frames, by id, merged from tiles; the rules are those of `cags_common.tiles.splat_buffer`, and so
 * are the bits. Columns lie in the kernels' memory, where motion is evaluated and rows are packed for the GPU.
 */
import type { BufferPool } from "../bytes/pool.ts";
import type { Kernels } from "../decode/kernels.ts";
import { SH_REST_OF_DEGREE, type Splats, WIDTHS } from "../decode/splats.ts";
import {
  type Change, RAMP_COLUMNS, type RampColumn, UPDATE_COLUMNS, type UpdateColumn, type UpdateValues,
} from "../decode/updates.ts";
import { ABSENT_LOGIT, endOf, endsAll, moveRows, MovingTile } from "../motion/apply.ts";
import type { Chunk } from "../motion/chunk.ts";
import type { StoredLooks } from "./storedTiles.ts";
import { type Key, tileOf } from "./keys.ts";
import { Ramps } from "./ramps.ts";

const MOVING = ["means", "quats", "logit_opacities"] as const;
type Moving = (typeof MOVING)[number];
const COLUMNS = ["means", "quats", "log_scales", "logit_opacities", "sh0", "sh_rest"] as const;
type ColumnName = (typeof COLUMNS)[number];

/** What is known of the motion of one tile of looks. */
class Motion {
  /** First media frame -> motion from it on, and the time from which on nothing of it changes. */
  readonly chunks = new Map<number, { readonly chunk: Chunk; readonly end: number }>();
  /** First frame of the chunk that is shown, and the time; undefined: splats are as their looks say. */
  shown: readonly [number, number] | undefined;
  /** Whether looks or motion came since. */
  dirty = true;
  /** Whether opacities of looks were updated since: those of what is in motion have to be evaluated again. */
  updated = false;
  private tile: MovingTile | undefined;

  /** First frame of the chunk to show at `time`. */
  start(time: number): number | undefined {
    let found: number | undefined;
    for (const first of this.chunks.keys()) if (first <= time && (found === undefined || first > found)) found = first;
    return found;
  }

  /** Whether the chunk from `start` is shown as it is at `time` already. */
  settled(start: number, time: number): boolean {
    if (this.dirty || this.updated || !this.shown || this.shown[0] !== start) return false;
    return this.shown[1] === time || Math.min(this.shown[1], time) >= this.chunks.get(start)!.end;
  }

  /** The splats of a tile that are not shown as they are at `time`: all of them, but where the same chunk is shown. Made anew
   * only where something else than the time has changed, and who has ended. */
  tileAt(kernels: Kernels, start: number, time: number, held: StoredLooks): MovingTile {
    const { chunk } = this.chunks.get(start)!;
    const { tile } = this;
    if (!tile || tile.chunk !== chunk || tile.rows !== held.rows || tile.steps !== held.steps) {
      this.dispose();
      this.tile = new MovingTile(kernels, chunk, held.rows!, held.steps!);
    }
    this.tile!.time = time - start;
    if (this.dirty || this.shown?.[0] !== start) return this.tile!.whole();
    return this.tile!.inMotion(this.updated ? undefined : this.shown[1] - start);
  }

  /** From now on `rows` [n], which {@link tileAt} was given, are without `those` [n] that are not 0. */
  lose(rows: Int32Array, those: Uint8Array): void {
    if (this.tile?.rows === rows) this.tile.lose(those);
    else those.forEach((lost, i) => { if (lost) rows[i] = -1; });
  }

  dispose(): void {
    this.tile?.dispose();
    this.tile = undefined;
  }
}

/** Rows are splat ids. Memory for `capacity` rows is taken when something is written, until {@link dispose}. */
export class SplatBuffer {
  readonly capacity: number;
  readonly shCount: number;
  /** Every tile of looks that was added, by its index. */
  readonly slots: StoredLooks[] = [];
  private readonly kernels: Kernels;
  private readonly onReplaced: (slot: StoredLooks) => void;
  private readonly byKey = new Map<Key, StoredLooks>();
  private readonly motions = new Map<Key, Motion>();
  private columns: Record<ColumnName, number> | undefined;
  private still: Record<Moving, number> | undefined;
  private owners: Int32Array | undefined;
  private sources!: Int32Array;
  private removedAt!: Int32Array;
  private seen!: Uint8Array; // all zeros but within a call
  private updated!: Record<UpdateColumn, Int32Array>;
  private readonly ramps: Record<RampColumn, Ramps> = { log_scales: new Ramps(), sh0: new Ramps(), sh_rest: new Ramps() };

  /** `onReplaced` hears of each tile of which nothing is shown any more. */
  constructor(kernels: Kernels, capacity: number, shDegree: number, onReplaced: (slot: StoredLooks) => void) {
    this.kernels = kernels;
    this.capacity = capacity;
    this.shCount = SH_REST_OF_DEGREE[shDegree]!;
    this.onReplaced = onReplaced;
  }

  /** Free what the kernels keep, as if nothing had been written; the tiles stay, and their motion. {@link clear} before
   * anything is written again. */
  dispose(): void {
    for (const motion of this.motions.values()) motion.dispose();
    for (const at of [...Object.values(this.columns ?? {}), ...Object.values(this.still ?? {})]) this.kernels.free(at);
    this.columns = this.still = undefined;
  }

  /** Numbers a row of a column. */
  width(column: ColumnName): number {
    return column === "sh_rest" ? 3 * this.shCount : WIDTHS[column];
  }

  /** A column of those on display; a view that ends with the next call of the kernels. */
  column(column: ColumnName): Float32Array<ArrayBuffer> {
    return this.kernels.f32(this.made()[column], this.capacity * this.width(column));
  }

  /** [capacity] index of the tile of looks that a row is from; -1 where there is no splat. */
  get owner(): Int32Array {
    this.made();
    return this.owners!;
  }

  /** Rows as `update.wgsl` takes them: [rows, 1 + width], in memory of `pool`; with `all` every column, else what motion
   * changes. */
  packed(rows: Int32Array, all: boolean, pool: BufferPool): { words: Uint32Array<ArrayBuffer>; width: number } {
    const columns = this.made();
    const width = all ? 14 + 3 * this.shCount : 8;
    return this.kernels.scoped((scope) => {
      const [given, out, splats] = [scope.put(rows), scope.take(4 * rows.length * (1 + width)), scope.take(28)];
      const { means, quats, log_scales, logit_opacities, sh0, sh_rest } = columns;
      this.kernels.u32(splats, 7).set([means, quats, log_scales, logit_opacities, sh0, sh_rest, 3 * this.shCount]);
      this.kernels.calls.cags_web_pack(splats, rows.length, given, all ? 1 : 0, out);
      return { words: pool.copy(this.kernels.u32(out, rows.length * (1 + width))), width };
    });
  }

  /** Take a tile of looks in, before anything of it is written; its index is the number of those before it. */
  add(slot: StoredLooks): void {
    this.slots.push(slot);
    this.byKey.set(slot.key, slot);
  }

  /** Back to no splats; the tiles stay, and their motion. */
  clear(): void {
    this.column("logit_opacities").fill(ABSENT_LOGIT);
    this.stillColumn("logit_opacities").fill(ABSENT_LOGIT);
    for (const rows of [this.owners!, this.sources, this.removedAt, ...Object.values(this.updated)]) rows.fill(-1);
    for (const ramps of Object.values(this.ramps)) ramps.clear();
    for (const motion of this.motions.values()) {
      motion.shown = undefined;
      motion.dirty = true;
    }
    for (const slot of this.slots) {
      slot.rows = undefined;
      slot.ended = false;
    }
  }

  private made(): Record<ColumnName, number> {
    if (this.columns) return this.columns;
    const k = this.kernels;
    const room = (column: ColumnName): number => k.allocate(4 * this.capacity * this.width(column));
    this.columns = Object.fromEntries(COLUMNS.map((name) => [name, room(name)])) as Record<ColumnName, number>;
    this.still = Object.fromEntries(MOVING.map((name) => [name, room(name)])) as Record<Moving, number>;
    const unset = (): Int32Array => new Int32Array(this.capacity).fill(-1);
    [this.owners, this.sources, this.removedAt] = [unset(), unset(), unset()];
    this.seen = new Uint8Array(this.capacity);
    this.updated = { log_scales: unset(), logit_opacities: unset(), sh0: unset(), sh_rest: unset() };
    for (const name of COLUMNS) blank(this.column(name), name);
    for (const name of MOVING) blank(this.stillColumn(name), name);
    return this.columns;
  }

  private stillColumn(column: Moving): Float32Array<ArrayBuffer> {
    this.made();
    return this.kernels.f32(this.still![column], this.capacity * WIDTHS[column]);
  }

  // -------------------------------------------------------------------------------------------------------------- looks

  /** End `ids` at media frame `frame`; those that were shown until now. */
  remove(frame: number, ids: Int32Array): Int32Array {
    this.made();
    for (const id of ids) this.removedAt[id] = Math.max(this.removedAt[id]!, frame);
    const gone = ids.filter((id) => this.sources[id]! < frame);
    this.release(gone);
    const logits = this.column("logit_opacities");
    for (const id of gone) {
      this.owners![id] = -1;
      logits[id] = ABSENT_LOGIT; // what an update says of splats that are to come stays
    }
    return gone;
  }

  /** Show a tile of looks at `lod`: `splats` [n] by `ids` [n]. The ids of those that are its to show. */
  write(slot: StoredLooks, lod: number, ids: Int32Array, splats: Splats): Int32Array {
    this.made();
    slot.ids = ids;
    slot.rows = undefined;
    const chosen: number[] = [];
    const claimed: number[] = [];
    for (let i = 0; i < ids.length; i++) {
      const mine = this.owners![ids[i]!] === slot.index;
      const newer = !mine && this.yields(slot, ids[i]!);
      if (newer) claimed.push(ids[i]!);
      if (mine || newer) chosen.push(i);
    }
    this.release(claimed);
    for (const id of claimed) {
      this.owners![id] = slot.index;
      this.sources[id] = slot.frame;
    }
    slot.owned += claimed.length;
    const rows = Int32Array.from(chosen, (i) => ids[i]!);
    this.put(slot, rows, chosen, splats);
    slot.shownLod = lod;
    if (!slot.owned) this.onReplaced(slot);
    return rows;
  }

  /** Whether a row is of an older frame, or of a later tile of the frame of `slot`. */
  private yields(slot: StoredLooks, id: number): boolean {
    const source = this.sources[id]!;
    if (source < slot.frame) return this.removedAt[id]! <= slot.frame;
    const owner = this.owners![id]!;
    return source === slot.frame && owner >= 0 && tileOf(this.slots[owner]!.key) > tileOf(slot.key);
  }

  /** Looks of `slot`; what updates of its frame and of later ones changed stays. */
  private put(slot: StoredLooks, rows: Int32Array, chosen: readonly number[], splats: Splats): void {
    const moving = this.touch(slot);
    for (const name of COLUMNS) {
      const [target, width, values] = [this.column(name), this.width(name), splats[name]];
      const still = isMoving(name) ? this.stillColumn(name) : undefined;
      const base = still ?? target;
      const updated = isUpdatable(name) ? this.updated[name] : undefined;
      const ramps = isRamped(name) ? this.ramps[name] : undefined;
      for (let k = 0; k < rows.length; k++) {
        const row = rows[k]!;
        const [to, from] = [row * width, chosen[k]! * width];
        if (!updated || updated[row]! < slot.frame) {
          for (let d = 0; d < width; d++) base[to + d] = values[from + d]!;
          if (updated) updated[row] = -1;
          ramps?.drop(row);
        } else {
          ramps?.standOn(row, slot.frame, values.slice(from, from + width));
        }
        if (still && !moving) for (let d = 0; d < width; d++) target[to + d] = still[to + d]!;
      }
    }
  }

  /** Something of `slot` changed; whether it is for {@link move} to show its moving columns. */
  private touch(slot: StoredLooks): boolean {
    const motion = this.motions.get(slot.key);
    if (!motion) return false;
    motion.dirty = true;
    return motion.shown !== undefined;
  }

  /** These rows leave the tiles that own them. */
  private release(rows: Iterable<number>): void {
    const counts = new Map<number, number>();
    for (const row of rows) {
      const owner = this.owners![row]!;
      if (owner >= 0) counts.set(owner, (counts.get(owner) ?? 0) + 1);
    }
    for (const index of [...counts.keys()].sort((a, b) => a - b)) {
      const slot = this.slots[index]!;
      slot.lost = true;
      slot.owned -= counts.get(index)!;
      if (!slot.owned) this.onReplaced(slot);
    }
  }

  // ------------------------------------------------------------------------------------------------------------ updates

  /** Take an update of media frame `frame` into what is shown at `time` (media frames); the rows that changed, each once. Ramps
   * that `time` has not passed are shown by {@link ramp}. */
  update(frame: number, values: UpdateValues, time: number): Int32Array {
    this.made();
    const rows = new Int32Array([...values.values()].reduce((sum, { ids }) => sum + ids.length, 0));
    let count = 0;
    for (const [column, change] of values) {
      const chosen = this.chosen(frame, column, change.ids);
      for (const i of chosen) {
        const id = change.ids[i]!;
        if (this.owners![id]! >= 0 && !this.seen[id]) rows[count++] = id;
        this.seen[id] = 1;
      }
      if (isRamped(column)) this.takeRamps(frame, column, change, chosen, time);
      else this.takeColumn(frame, column, change, chosen);
    }
    for (const { ids } of values.values()) for (const id of ids) this.seen[id] = 0;
    return rows.subarray(0, count);
  }

  /** An update of what motion changes too. */
  private takeColumn(frame: number, column: UpdateColumn, { ids, values }: Change, chosen: Int32Array): void {
    const [target, width, updated, owners] = [this.column(column), this.width(column), this.updated[column], this.owners!];
    const still = isMoving(column) ? this.stillColumn(column) : undefined;
    const touched = new Set<number>();
    for (const i of chosen) {
      const id = ids[i]!;
      updated[id] = frame;
      if (still) {
        for (let d = 0; d < width; d++) still[id * width + d] = values[i * width + d]!;
        if (owners[id]! < 0) continue;
        touched.add(owners[id]!);
      }
      for (let d = 0; d < width; d++) target[id * width + d] = values[i * width + d]!; // in motion: evaluated once more
    }
    for (const index of touched) {
      const motion = this.motions.get(this.slots[index]!.key);
      if (motion) motion.updated = true;
    }
  }

  /** An update of what may be on its way to its value. */
  private takeRamps(frame: number, column: RampColumn, change: Change, chosen: Int32Array, time: number): void {
    const { ids, values, frames } = change;
    const [target, width, updated, ramps] = [this.column(column), this.width(column), this.updated[column], this.ramps[column]];
    let next = 0;
    for (let i = 0; i < ids.length; i++) {
      const id = ids[i]!;
      const taken = chosen[next] === i;
      if (!taken) {
        if (this.sources[id]! <= frame && this.removedAt[id]! <= frame) {
          ramps.precede(id, frame, values.slice(i * width, (i + 1) * width));
        }
        continue;
      }
      next++;
      const since = updated[id]!;
      updated[id] = frame;
      const value = values.subarray(i * width, (i + 1) * width);
      if (frame + frames[i]! > time + 1) {
        const kept = value.slice();
        if (ramps.refine(id, frame, kept)) continue;
        const from = ramps.end(id) ?? target.slice(id * width, (id + 1) * width);
        ramps.put(id, frame, frames[i]!, from, kept, since);
      } else {
        ramps.drop(id);
        target.set(value, id * width);
      }
    }
  }

  /** Show attributes that are on their way as they are at `time` (media frames), and tell of each row that changed and the media
   * frame of its update. */
  ramp(time: number, tell: (row: number, began: number) => void): void {
    this.made();
    for (const name of RAMP_COLUMNS) {
      this.ramps[name].at(time, this.column(name), this.width(name), (id, began) => {
        if (this.owners![id]! >= 0) tell(id, began);
      });
    }
  }

  /** Which of `ids` an update of `frame` still says anything new of. */
  private chosen(frame: number, column: UpdateColumn, ids: Int32Array): Int32Array {
    const [updated, out] = [this.updated[column], new Int32Array(ids.length)];
    let count = 0;
    for (let i = 0; i < ids.length; i++) {
      const id = ids[i]!;
      if (updated[id]! <= frame && this.sources[id]! <= frame && this.removedAt[id]! <= frame) out[count++] = i;
    }
    return out.subarray(0, count);
  }

  /** Whether the update of `frame` of columns' `idsOf` is the newest for any splat that is there or may come, or a ramp begins at
   * it; with `shown`: for any that is there at the time shown. */
  uses(frame: number, idsOf: ReadonlyMap<string, Int32Array>, shown = false): boolean {
    const logits = this.column("logit_opacities");
    for (const [column, ids] of idsOf) {
      const updated = this.updated[column as UpdateColumn];
      const ramps = isRamped(column) ? this.ramps[column] : undefined;
      const used = ids.some((id) => {
        if (ramps?.follows(id, frame)) return true;
        if (updated[id] !== frame || this.removedAt[id]! > frame) return false;
        return !shown || (this.owners![id]! >= 0 && logits[id]! > ABSENT_LOGIT);
      });
      if (used) return true;
    }
    return false;
  }

  // ------------------------------------------------------------------------------------------------------------- motion

  /** Take the motion of the splats of tile `looks` from media frame `start` on, or more of its levels. */
  setMotion(looks: Key, start: number, chunk: Chunk): void {
    let motion = this.motions.get(looks);
    if (!motion) this.motions.set(looks, (motion = new Motion()));
    motion.chunks.set(start, { chunk, end: start + endOf(chunk) });
    motion.dirty = true;
  }

  /** Nothing of tile `looks` moves any more. */
  dropMotion(looks: Key): void {
    this.motions.get(looks)?.dispose();
    this.motions.delete(looks);
  }

  /** Forget chunks that later ones have followed by `time`, each by its looks and first frame. */
  dropPast(time: number): (readonly [Key, number])[] {
    const gone: (readonly [Key, number])[] = [];
    for (const [looks, motion] of this.motions) {
      const start = motion.chunks.size < 2 ? undefined : motion.start(time);
      if (start === undefined) continue;
      for (const first of [...motion.chunks.keys()].filter((f) => f < start)) {
        motion.chunks.delete(first);
        gone.push([looks, first]);
      }
    }
    return gone;
  }

  /** First media frame of the chunk that moves the splats of tile `looks` at the time shown. */
  moves(looks: Key): number | undefined {
    return this.motions.get(looks)?.shown?.[0];
  }

  /** Show every splat where it is at `time` (media frames); the rows that changed, tile by tile and ascending in each. */
  move(time: number): Int32Array[] {
    const tiles: MovingTile[] = [];
    for (const [looks, motion] of this.motions) {
      const slot = this.byKey.get(looks);
      const start = slot?.owned && slot.steps ? motion.start(time) : undefined;
      if (!slot || start === undefined || motion.settled(start, time)) continue;
      if (!slot.rows) slot.rows = slot.ids.map((id) => (this.owners![id] === slot.index ? id : -1));
      else if (slot.lost) motion.lose(slot.rows, Uint8Array.from(slot.ids, (id) => Number(this.owners![id] !== slot.index)));
      slot.lost = false;
      tiles.push(motion.tileAt(this.kernels, start, time, slot));
      const { chunk, end } = motion.chunks.get(start)!;
      slot.ended = time >= end && endsAll(chunk);
      motion.shown = [start, time];
      motion.dirty = motion.updated = false;
    }
    if (!tiles.length) return [];
    const columns = this.made();
    const from = { means: this.still!.means, quats: this.still!.quats, logits: this.still!.logit_opacities };
    const into = { means: columns.means, quats: columns.quats, logits: columns.logit_opacities };
    moveRows(this.kernels, tiles, this.capacity, from, into);
    return tiles.map((tile) => tile.owned);
  }
}

function isMoving(name: string): name is Moving {
  return (MOVING as readonly string[]).includes(name);
}

function isRamped(name: string): name is RampColumn {
  return (RAMP_COLUMNS as readonly string[]).includes(name);
}

function isUpdatable(name: string): name is UpdateColumn {
  return (UPDATE_COLUMNS as readonly string[]).includes(name);
}

function blank(values: Float32Array, column: ColumnName): void {
  values.fill(column === "log_scales" ? -10 : column === "logit_opacities" ? ABSENT_LOGIT : 0);
  if (column === "quats") for (let i = 0; i < values.length; i += 4) values[i] = 1;
}
