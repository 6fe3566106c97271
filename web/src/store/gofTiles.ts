/**
 * What has come of one group of frames: tiles of any kind at any depth, in any order of arrival; as
 * `cags_common.store.gof_tiles`, in one thread.
 *
 * Tiles are decoded when they arrive and then staged: dequantised, for the display to take. What is replaced or past
 * stays for showing earlier frames again, within bounds.
 */
import { DecodeError } from "../bytes/errors.ts";
import type { AnyTile } from "../decode/codec.ts";
import { LEVELS, MOTION_VERSION, type MotionTile, readLooks } from "../motion/chunk.ts";
import type { HeldTile } from "../wire/messages.ts";
import { type StoredTile, StoredLooks, StoredMotion, StoredUpdate, Motions, type Sphere, type Staged, toStage } from "./storedTiles.ts";
import { frameOf, type Key, looksKey, named, tileOf } from "./keys.ts";
import type { Opener } from "./opener.ts";
import { Versions } from "./versions.ts";
import { type Layer, WaitingLayers } from "./reorderBuffer.ts";

const MAX_LATE_BYTES = 8 << 20;
const MAX_TILES_PER_GOF = 1 << 17;
export const MAX_KEPT_SPLATS = 1 << 22;
const KEPT_SPLAT_BYTES = 40;
/** Frames ahead of the display whose kept tiles are dequantised off the display path. */
const REPLAY_AHEAD = 8;

/** Layers of one tile as a message brings them: `payloads[i]` is LoD `fromLod + i`. */
export interface Arrival {
  readonly key: Key;
  readonly fromLod: number;
  readonly payloads: readonly Uint8Array[];
}

export interface GofTilesOptions {
  /** First media frame of the group, and the first one after it. */
  readonly range: readonly [number, number];
  readonly capacity: number;
  readonly codec: Opener;
  /** Whether the bundle has motion. */
  readonly inMotion: boolean;
  /** The last mark that came. */
  readonly mark: number;
}

export class GofTiles {
  /** What comes belongs to every mark after this one. Set after a flush. */
  mark: number;
  /** Whether earlier frames of the group can be shown again from what is held. */
  keeps = true;
  private readonly options: GofTilesOptions;
  private readonly tiles = new Map<Key, StoredTile | null>(); // null: nothing of it is shown any more, and it is not kept
  private readonly motions = new Motions();
  private readonly late = new Map<Key, { mark: number; lod: number; payload: Uint8Array }[]>();
  private readonly replay = new Map<Key, StoredTile>();
  private replacedSplats = 0;
  private lateBytes = 0;
  private motionBytes = 0;
  private updatedSplats = 0;
  private readonly waiting = new WaitingLayers();
  private dropped: HeldTile[] = [];
  private readonly touched = new Map<Key, StoredTile>();
  private errors: DecodeError[] = [];
  private readonly staged = new Map<Key, Staged[]>(); // a tile's in the order of marks
  private readonly several = new Map<Key, StoredTile>(); // of which versions may be over
  private horizon = -1;
  private basis = Infinity; // of what is shown
  private floor = -Infinity; // no mark before it is asked for any more

  constructor(options: GofTilesOptions) {
    this.options = options;
    this.mark = options.mark;
  }

  // ------------------------------------------------------------------------------------------------------------ arrival

  /** Decode tiles' layers; what is wrong with those that are left out. Duplicates change nothing. */
  add(arrivals: readonly Arrival[]): DecodeError[] {
    const errors: DecodeError[] = [];
    for (const { key, fromLod, payloads } of arrivals) {
      const layers = payloads.map((payload, i) => ({ lod: fromLod + i, payload }));
      gathered(errors, () => this.addLayers(key, layers));
    }
    return errors;
  }

  /** Dequantise and stage what {@link add} touched; what is wrong with tiles that are left out. */
  flush(): DecodeError[] {
    this.stage(Infinity, this.horizon + REPLAY_AHEAD);
    const errors = this.errors;
    this.errors = [];
    return errors;
  }

  /** What had come and was given up since the last call, for want of memory. */
  takeDropped(): HeldTile[] {
    const dropped = this.dropped;
    this.dropped = [];
    return dropped;
  }

  /** Another store of so many LoDs, from 0 on, of each tile, and of nothing else; undefined: of what {@link held} says. */
  resumed(inventory: ReadonlyMap<Key, number> | undefined): GofTiles {
    const other = new GofTiles({ ...this.options, mark: this.mark });
    other.horizon = this.horizon;
    const moving: StoredMotion[] = [];
    const levels = new Map<Key, number>();
    for (const key of [...this.tiles.keys()].sort((a, b) => a - b)) {
      const held = this.tiles.get(key);
      const lods = held ? (inventory ? inventory.get(key) : held.lods) : 0;
      if (!held || (inventory && !lods)) continue;
      levels.set(key, lods!);
      if (held.kind === "looks") this.handOverLooks(held, lods!, other);
      else if (held.kind === "motion") moving.push(held);
      else {
        const state = held.versions.newest;
        const update = new StoredUpdate(key, new Versions(state.reduced(Math.min(lods!, state.lod + 1)), this.mark));
        other.replay.set(key, other.takeUpdate(update));
      }
    }
    for (const motion of moving) {
      const count = Math.min(motion.lods, levels.get(motion.key)!);
      const payloads = Array.from({ length: count }, (_, level) => motion.payloads.get(level)!.data);
      other.errors.push(...other.add([{ key: motion.key, fromLod: 0, payloads }]));
    }
    const [first, end] = this.options.range;
    for (const [key, lods] of inventory ?? []) { // what the server believes in, as motion that waited for its looks
      const [frame, have] = [frameOf(key), other.tiles.get(key)?.lods ?? 0];
      if (first <= frame && frame < end && have < lods) other.dropped.push({ frame, tile: tileOf(key), lods: have });
    }
    return other;
  }

  private handOverLooks(held: StoredLooks, lods: number, other: GofTiles): void {
    const state = held.versions.newest.fork();
    const late = lods > held.lods ? (this.late.get(held.key) ?? []) : [];
    for (const { lod, payload } of late) forgiven(() => void state.addLayer(lod, payload));
    const reduced = state.reduced(Math.min(lods, state.lod + 1));
    const taken = new StoredLooks(held.key, held.sphere, new Versions(reduced, this.mark));
    other.tiles.set(held.key, taken);
    other.replay.set(held.key, taken);
  }

  private addLayers(key: Key, given: Layer[]): void {
    let layers = given;
    let held = this.tiles.get(key);
    if (held === null) return;
    if (held?.kind === "looks" && held.replaced) return this.keepLate(key, layers); // of use once earlier frames are shown again
    if (held === undefined) {
      const first = layers[0];
      if (!first || first.lod || this.waits(key, first.payload)) return this.wait(key, layers);
      const looks = this.looksFor(key, first.payload);
      if (looks === null) return void this.tiles.set(key, null);
      held = this.take(key, first.payload, this.options.codec.open(first.payload, looks?.versions.newest));
      this.touched.set(key, held);
      layers = [...layers.slice(1), ...this.waiting.take(key)];
    }
    for (const { lod, payload } of layers) if (lod > 0 && this.addLayer(held, lod, payload)) this.touched.set(key, held);
  }

  private addLayer(held: StoredTile, lod: number, payload: Uint8Array): boolean {
    const { versions } = held;
    let changed = false;
    try {
      if (versions && lod > versions.newest.lod) changed = versions.writable(this.mark).addLayer(lod, payload);
    } catch (error) {
      if (error instanceof DecodeError && held.kind === "motion") this.dropLevels(held);
      throw error; // of this level, or of one that had to wait for it
    }
    if (changed) versions?.touch();
    if (versions && versions.length > 1) this.several.set(held.key, held);
    if (held.kind === "motion" && lod > 0 && lod < LEVELS) this.keepMotion(held, lod, payload);
    return changed;
  }

  /** Whether `key` moves looks that have not come. Raises {@link DecodeError}. */
  private waits(key: Key, payload: Uint8Array): boolean {
    const named_ = this.options.inMotion ? looksOf(payload) : undefined;
    if (!named_) return false;
    const looks = looksKey(...named_);
    if (this.tiles.has(looks)) return false;
    if (named_[0] < this.options.range[0] || named_[0] > frameOf(key)) {
      throw new DecodeError(`${named(key)}: moves looks of frame ${named_[0]}, which is not of its group of frames up to it`);
    }
    this.motions.wait(key, looks);
    return true;
  }

  private wait(key: Key, layers: readonly Layer[]): void {
    for (const gone of this.waiting.add(key, layers)) {
      this.motions.giveUp(gone);
      this.dropped.push({ frame: frameOf(gone), tile: tileOf(gone), lods: 0 });
    }
  }

  /** The looks that a tile of motion moves, null where they are not kept; undefined of other kinds. Raises {@link DecodeError}. */
  private looksFor(key: Key, payload: Uint8Array): StoredLooks | null | undefined {
    const named_ = this.options.inMotion ? looksOf(payload) : undefined;
    const looks = named_ && this.tiles.get(looksKey(...named_));
    if (!named_) return undefined;
    if (looks === null) return null;
    if (looks?.kind !== "looks" || looks.frame > frameOf(key)) {
      throw new DecodeError(`${named(key)}: moves tile ${named_[1]} of frame ${named_[0]}, which holds no splats that move by then`);
    }
    return looks;
  }

  /** A tile that is new. Raises {@link DecodeError}. */
  private take(key: Key, payload: Uint8Array, tile: AnyTile): StoredTile {
    if (this.tiles.size >= MAX_TILES_PER_GOF) {
      throw new DecodeError(`${named(key)}: the group already has ${MAX_TILES_PER_GOF} tiles`);
    }
    if (tile.kind === "motion") return this.takeMotion(key, payload, tile);
    this.checkIds(tile.ids, named(key));
    if (tile.kind === "update") return this.takeUpdate(new StoredUpdate(key, new Versions(tile, this.mark)));
    const held = new StoredLooks(key, sphereOf(tile.means), new Versions(tile, this.mark));
    this.tiles.set(key, held);
    this.bring(this.motions.come(key));
    return held;
  }

  /** Looks have come: take the motion that waited for them. Errors wait for the next {@link flush}. */
  private bring(waiting: readonly Key[]): void {
    for (const key of waiting) {
      for (const layer of this.waiting.take(key).sort((a, b) => a.lod - b.lod)) {
        gathered(this.errors, () => this.addLayers(key, [layer]));
      }
    }
  }

  private takeMotion(key: Key, payload: Uint8Array, state: MotionTile): StoredMotion {
    const looksAt = looksKey(...state.looks);
    const held = new StoredMotion(key, looksAt, new Versions(state, this.mark));
    this.tiles.set(key, held);
    const before = this.motions.add(held);
    if (before) this.tiles.set(before.key, null);
    this.keepMotion(held, 0, payload);
    return held;
  }

  private takeUpdate(held: StoredUpdate): StoredUpdate {
    this.tiles.set(held.key, held);
    this.updatedSplats += held.versions.newest.length;
    this.boundKept();
    return held;
  }

  /** Raise {@link DecodeError} for ids that the group does not have; they ascend. */
  checkIds(ids: Int32Array, what: string): void {
    if (ids.length && (ids[0]! < 0 || ids.at(-1)! >= this.options.capacity)) {
      throw new DecodeError(`${what}: id ${ids.at(-1)} is outside the group's capacity ${this.options.capacity}`);
    }
  }

  private keepLate(key: Key, layers: readonly Layer[]): void {
    let late = this.late.get(key);
    if (!late) this.late.set(key, (late = []));
    for (const { lod, payload } of layers) {
      late.push({ mark: this.mark, lod, payload: payload.slice() });
      this.lateBytes += payload.length;
    }
    if (this.lateBytes > MAX_LATE_BYTES) this.stopKeeping();
  }

  private keepMotion(held: StoredMotion, level: number, payload: Uint8Array): void {
    if (held.payloads.has(level)) return;
    held.payloads.set(level, { since: this.mark, data: payload.slice() });
    this.motionBytes += payload.length;
    this.boundKept();
  }

  /** Of a tile of motion only what is decoded counts as held. */
  private dropLevels(held: StoredMotion): void {
    const decoded = held.versions?.newest.lod ?? 0;
    for (const [level, { data }] of [...held.payloads]) {
      if (level <= decoded) continue;
      held.payloads.delete(level);
      this.motionBytes -= data.length;
    }
  }

  /** Splats held for a replay alone; motion and updates count as the splats that take as much memory. */
  get keptSplats(): number {
    return this.replacedSplats + this.updatedSplats + Math.floor(this.motionBytes / KEPT_SPLAT_BYTES);
  }

  private boundKept(): void {
    if (this.keeps && this.keptSplats > MAX_KEPT_SPLATS) this.stopKeeping();
  }

  // ------------------------------------------------------------------------------------------------------------ staging

  /** Dequantise touched tiles of frames up to `horizon`, and those to be replayed of frames up to `replayed`. */
  stage(horizon: number, replayed: number): void {
    this.reopen([...this.replay.keys()].filter((key) => frameOf(key) <= replayed));
    for (const held of this.takeTouched(horizon)) {
      for (const item of toStage(held)) {
        let of = this.staged.get(held.key);
        if (!of) this.staged.set(held.key, (of = []));
        if (of.length && of.at(-1)!.since === item.since) of.pop();
        of.push(item);
      }
    }
  }

  /** Touch what is to be replayed; of the motion that is shown only what counts there is decoded again. */
  private reopen(keys: readonly Key[]): void {
    const motions: StoredMotion[] = [];
    for (const key of keys) {
      const held = this.replay.get(key)!;
      this.replay.delete(key);
      this.touched.set(key, held);
      if (held.kind !== "motion") continue;
      if (this.isFollowed(held)) this.retire(held);
      else if (!held.versions) motions.push(held);
    }
    for (const held of motions) {
      const looks = this.tiles.get(held.looks);
      const open = (payload: Uint8Array): MotionTile => {
        return this.options.codec.open(payload, looks?.kind === "looks" ? looks.versions.newest : undefined) as MotionTile;
      };
      gathered(this.errors, () => void (held.versions = held.opened(open, this.floor)));
    }
  }

  /** Whether a later chunk of the same looks is shown in its place. */
  private isFollowed(held: StoredMotion): boolean {
    const others = this.motions.of(held.looks);
    return others.some((other) => {
      const later = frameOf(held.key) < frameOf(other.key) && frameOf(other.key) <= this.horizon;
      return later && other.payloads.get(0)!.since < this.basis;
    });
  }

  private takeTouched(horizon: number): StoredTile[] {
    const out: StoredTile[] = [];
    for (const [key, held] of [...this.touched]) {
      if (frameOf(key) > horizon) continue;
      this.touched.delete(key);
      out.push(held);
    }
    return out;
  }

  // ------------------------------------------------------------------------------------------------------------ display

  /** Take what is staged of frames up to `horizon` and came before mark `basis`, in order. */
  due(horizon: number, basis: number): Staged[] {
    this.horizon = Math.max(this.horizon, horizon);
    this.basis = basis;
    const due: Staged[] = [];
    for (const key of [...this.staged.keys()].filter((k) => frameOf(k) <= horizon).sort((a, b) => a - b)) {
      const of = this.staged.get(key)!;
      const come = of.filter((item) => item.since < basis).length;
      if (come) due.push(of[come - 1]!);
      of.splice(0, come);
      if (!of.length) this.staged.delete(key);
    }
    this.trim(basis);
    return due;
  }

  /** Later marks alone are asked for from now on; nobody asked for one where everything is shown. */
  private trim(basis: number): void {
    if (basis === Infinity) return;
    this.floor = Math.max(this.floor, basis);
    for (const [key, held] of [...this.several]) {
      held.versions?.trim(this.floor);
      if (!held.versions || held.versions.length === 1) this.several.delete(key);
    }
  }

  /** Everything held waits to be shown again, in order; the looks that move. */
  rewind(horizon: number, basis: number): Key[] {
    this.horizon = horizon;
    this.basis = basis;
    this.trim(basis);
    for (const [key, held] of this.tiles) {
      if (!held) continue;
      this.replay.set(key, held);
      held.shownLod = -1;
      if (held.kind === "looks") {
        held.owned = 0;
        held.replaced = false;
        this.takeLate(held);
      }
      held.versions?.again();
    }
    this.staged.clear();
    this.touched.clear();
    this.replacedSplats = this.lateBytes = 0;
    return this.motions.looks();
  }

  private takeLate(held: StoredLooks): void {
    const late = this.late.get(held.key) ?? [];
    this.late.delete(held.key);
    for (const { mark, lod, payload } of late) {
      forgiven(() => { // damaged on the way: the tile stays as good as it was
        held.versions.writable(mark).addLayer(lod, payload);
        this.several.set(held.key, held);
      });
    }
  }

  /** Nothing of a tile is shown any more: it is kept for a replay while there is room. Its motion, now past. */
  replaced(held: StoredLooks): StoredMotion[] {
    this.staged.delete(held.key);
    held.replaced = true;
    const past = this.motions.of(held.key);
    for (const motion of past) this.retire(motion);
    this.replacedSplats += held.versions.newest.length;
    if (!this.keeps) this.tiles.set(held.key, null);
    this.boundKept();
    return past;
  }

  /** Later chunks of motion have followed these, each named by its looks and first frame: the tiles. */
  past(chunks: readonly (readonly [Key, number])[]): StoredMotion[] {
    const past = chunks.map(([looks, start]) => this.motions.at(looks, start)).filter((held) => held !== undefined);
    for (const held of past) this.retire(held);
    return past;
  }

  /** Nothing of an update is shown any more, and nothing is kept. */
  forget(update: StoredUpdate): void {
    this.giveUp(update);
  }

  /** Those that have been shown. */
  updates(): StoredUpdate[] {
    return [...this.tiles.values()].filter((held) => held?.kind === "update" && held.shownLod >= 0) as StoredUpdate[];
  }

  /** The tile of looks `key`. */
  looks(key: Key): StoredLooks | undefined {
    const held = this.tiles.get(key);
    return held?.kind === "looks" ? held : undefined;
  }

  /** The tiles of which splats are shown, wait to be, or are kept for a replay; motion and updates like looks. */
  held(): HeldTile[] {
    const out: HeldTile[] = [];
    for (const [key, held] of this.tiles) if (held) out.push({ frame: frameOf(key), tile: tileOf(key), lods: held.lods });
    return out;
  }

  /** A tile of motion is past, or nothing is left of what it moves: only its payloads stay. */
  private retire(held: StoredMotion): void {
    held.versions = undefined;
    this.staged.delete(held.key);
    if (!this.keeps) this.giveUp(held);
  }

  private giveUp(held: StoredTile): void {
    this.tiles.set(held.key, null);
    if (held.kind === "motion") this.motions.discard(held);
  }

  private stopKeeping(): void {
    this.keeps = false;
    this.late.clear();
    for (const held of [...this.tiles.values()]) {
      if (held?.kind === "looks" ? held.replaced : held?.kind === "motion" && !held.versions) this.giveUp(held!);
    }
  }
}

/** Run `work`, and keep a {@link DecodeError} that it raises. */
function gathered(errors: DecodeError[], work: () => void): void {
  try {
    work();
  } catch (error) {
    if (!(error instanceof DecodeError)) throw error;
    errors.push(error);
  }
}

function forgiven(work: () => void): void {
  gathered([], work);
}

function looksOf(payload: Uint8Array): readonly [number, number] | undefined {
  if (payload[0] !== MOTION_VERSION) return undefined;
  try {
    return readLooks(payload);
  } catch (error) {
    if (error instanceof DecodeError) return undefined;
    throw error;
  }
}

function sphereOf(means: Float32Array): Sphere {
  if (!means.length) return [0, 0, 0, 0];
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < means.length; i++) {
    low[i % 3] = Math.min(low[i % 3]!, means[i]!);
    high[i % 3] = Math.max(high[i % 3]!, means[i]!);
  }
  const [x, y, z] = low.map((l, i) => (l + high[i]!) / 2) as [number, number, number];
  return [x, y, z, Math.hypot(...low.map((l, i) => high[i]! - l)) / 2];
}
