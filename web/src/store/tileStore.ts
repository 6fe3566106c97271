/** What is held of a scene: a {@link GofBuffer} a group of frames; as `cags_common.store.tile_store`. A group is dropped
 * when the next one is first shown, except in a small clip, which is kept whole. */
import { BundleError, DecodeError } from "../bytes/errors.ts";
import type { Opener } from "./opener.ts";
import { gofOf, gofRange, type Manifest } from "../decode/manifest.ts";
import { type FrameRange, NO_FRAMES } from "../seam.ts";
import type { HeldTile } from "../wire/messages.ts";
import { type Changes, GofBuffer } from "./gofBuffer.ts";
import { type Arrival, MAX_KEPT_SPLATS } from "./gofTiles.ts";
import { frameOf, type Key, keyOf } from "./keys.ts";

/** What became visible; all rows where the group is new. */
export interface Committed {
  readonly gof: number;
  readonly rows: Int32Array;
  readonly began: Int32Array;
  readonly moved: Int32Array;
  readonly fresh: boolean;
  /** The end of this frame was not there: something older is shown. */
  readonly missed: boolean;
}

const NONE = new Int32Array(0);

export class TileStore {
  private readonly manifest: Manifest;
  private readonly codec: Opener;
  private gofs = new Map<number, GofBuffer>();
  private readonly alive = new Set<GofBuffer>();
  private shown: GofBuffer | undefined;
  private oldest = 0;
  private whole: boolean;
  private newestMark = 0;

  constructor(manifest: Manifest, codec: Opener) {
    this.manifest = manifest;
    this.codec = codec;
    this.whole = manifest.keptWhole;
  }

  // ------------------------------------------------------------------------------------------------------------ arrival

  /** Take layers of tiles; those of groups that are past are ignored. What is wrong with those that are left out. */
  add(arrivals: readonly Arrival[]): DecodeError[] {
    const errors: DecodeError[] = [];
    const byStore = new Map<GofBuffer, Arrival[]>();
    for (const arrival of arrivals) {
      try {
        const store = this.store(frameOf(arrival.key));
        if (!store) continue;
        const some = byStore.get(store);
        if (some) some.push(arrival);
        else byStore.set(store, [arrival]);
      } catch (error) {
        if (!(error instanceof DecodeError)) throw error;
        errors.push(error);
      }
    }
    for (const [store, some] of byStore) errors.push(...store.add(some));
    return errors;
  }

  /** Dequantise what {@link add} touched, each tile once, off the display path. */
  flush(): DecodeError[] {
    return [...this.gofs.values()].flatMap((store) => store.flush());
  }

  /** All that has come so far belongs to basis `number`, and what comes next does not. As {@link flush}. Raises
   * `RangeError` where numbers do not rise. */
  mark(number: number): DecodeError[] {
    if (number <= this.newestMark) throw new RangeError(`mark ${number} came after mark ${this.newestMark}: marks rise`);
    const errors = this.flush();
    this.newestMark = number;
    for (const store of this.gofs.values()) store.mark(number);
    return errors;
  }

  /** The server plans nothing more for `frame`. Raises {@link DecodeError}. */
  end(frame: number, removed: Int32Array): void {
    this.store(frame)?.end(frame, removed);
  }

  /** What was given up for want of memory since the last call. */
  takeDropped(): HeldTile[] {
    return [...this.gofs.values()].flatMap((store) => store.takeDropped());
  }

  /** From here on another connection brings what comes; it begins from `inventory` (undefined: what {@link held} says). */
  restarted(inventory?: readonly HeldTile[]): void {
    const levels = inventory && new Map(inventory.map((tile) => [keyOf(tile.frame, tile.tile), tile.lods]));
    this.gofs = new Map([...this.gofs].map(([gof, store]) => [gof, this.living(store.resumed(levels))]));
    this.sweep();
  }

  /** Forget everything: the viewer jumped to `frame`. */
  reset(frame: number): void {
    this.gofs.clear();
    this.shown = undefined;
    this.oldest = gofOf(this.manifest, frame);
    this.whole = this.manifest.keptWhole;
    this.sweep();
  }

  // ------------------------------------------------------------------------------------------------------------ display

  /** Make what came up to mark `basis` (undefined: everything) for `frame` visible. While nothing of its group is whole,
   * the group before stays on display as of its last frame; where the clip is kept whole, the one before the first group
   * is the last. */
  commit(frame: number, basis?: number): [GofBuffer, Committed] {
    const gof = this.checkedGof(frame);
    const made = new Map<GofBuffer, Changes>();
    const wanted = this.store(frame);
    if (!wanted) throw new RangeError(`frame ${frame} is past: a jump back begins with a reset`);
    let begun: GofBuffer | undefined;
    const count = this.manifest.gofStarts.length;
    const there = [...this.gofs.keys()].filter((n) => this.whole || n <= gof);
    for (const number of there.sort((a, b) => ((gof - a + count) % count) - ((gof - b + count) % count))) {
      const store = this.gofs.get(number)!;
      made.set(store, store.commit(number === gof ? frame : gofRange(this.manifest, number)[1] - 1, basis));
      if (!store.begun) continue;
      begun = store;
      this.showGroup(number, gof);
      break;
    }
    const shown = begun ?? this.shown ?? wanted;
    const { rows, began, moved, whole } = made.get(shown) ?? { rows: NONE, began: NONE, moved: NONE, whole: false };
    const fresh = shown !== this.shown;
    this.shown = shown;
    this.sweep();
    return [shown, { gof, rows, began, moved, fresh, missed: shown !== wanted || !whole }];
  }

  /** Show the splats on display where they are `share` frames after `frame`, the last that was committed; undefined where
   * another is. */
  move(frame: number, share: number): [GofBuffer, Committed] | undefined {
    const store = this.shown;
    if (!store || store.shownFrame !== frame) return undefined;
    const moved = store.move(frame + share);
    return [store, { gof: gofOf(this.manifest, frame), rows: NONE, began: NONE, moved, fresh: false, missed: !store.whole }];
  }

  /** Group `gof` is on display in place of `wanted`: past ones are dropped; where the clip is kept whole, the others rest. */
  private showGroup(gof: number, wanted: number): void {
    this.oldest = Math.min(gof, wanted); // later where the last group is shown before the first
    const stores = [...this.gofs.values()];
    const kept = stores.reduce((sum, store) => sum + store.keptSplats, 0);
    this.whole &&= stores.every((store) => store.keeps) && kept <= MAX_KEPT_SPLATS;
    for (const [number, store] of [...this.gofs]) {
      if (number === gof || number === wanted) continue;
      if (this.whole) store.rest();
      else if (number < this.oldest) this.gofs.delete(number);
    }
  }

  // ------------------------------------------------------------------------------------------------------------ figures

  get onDisplay(): GofBuffer | undefined {
    return this.shown;
  }

  /** Frames among which the play can jump and go on with what is held of them: those of the clip, of the group on
   * display, or none. */
  get kept(): FrameRange {
    if (this.whole && [...this.gofs.values()].every((store) => store.keeps)) return [0, this.manifest.frames];
    return this.shown?.keeps ?? true ? gofRange(this.manifest, this.oldest) : NO_FRAMES;
  }

  /** One more than the largest splat id in the group of `frame`. Raises {@link DecodeError}. */
  capacity(frame: number): number {
    return this.manifest.capacity[this.checkedGof(frame)]!;
  }

  /** Whether `frame` can be shown whole without anything from the network. */
  holds(frame: number): boolean {
    return this.gofs.get(gofOf(this.manifest, frame))?.holds(frame) ?? false;
  }

  /** Frames after `frame` up to the newest that has come whole. */
  ahead(frame: number): number {
    return Math.max(Math.max(-1, ...[...this.gofs.values()].map((store) => store.newest)) - frame, 0);
  }

  /** Every tile that would not have to be sent again. */
  held(): HeldTile[] {
    return [...this.gofs.values()].flatMap((store) => store.held());
  }

  private checkedGof(frame: number): number {
    try {
      return gofOf(this.manifest, frame);
    } catch (error) {
      if (!(error instanceof BundleError)) throw error;
      throw new DecodeError(`frame ${frame} is outside the clip's ${this.manifest.frames} frames`);
    }
  }

  private store(frame: number): GofBuffer | undefined {
    const gof = this.checkedGof(frame);
    if (gof < this.oldest && !this.whole) return undefined;
    let store = this.gofs.get(gof);
    if (!store) this.gofs.set(gof, (store = this.living(new GofBuffer(this.manifest, gof, this.codec, this.newestMark))));
    return store;
  }

  private living(store: GofBuffer): GofBuffer {
    this.alive.add(store);
    return store;
  }

  /** Free the splats of stores that nobody can show any more. */
  private sweep(): void {
    const needed = new Set(this.gofs.values());
    for (const store of this.alive) {
      if (store === this.shown || needed.has(store)) continue;
      this.alive.delete(store);
      store.dispose();
    }
  }

  /** Free everything. */
  dispose(): void {
    this.reset(0);
  }
}

/** What a {@link TileStore.add} takes of a tile message. */
export function arrivalOf(frame: number, tile: number, fromLod: number, payloads: readonly Uint8Array[]): Arrival {
  const key: Key = keyOf(frame, tile);
  return { key, fromLod, payloads };
}
