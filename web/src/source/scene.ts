/** What every source shares: a store, and frames of it as patches for the GPU. */
import { DecodeError } from "../bytes/errors.ts";
import { BufferPool } from "../bytes/pool.ts";
import { TileCodec } from "../decode/codec.ts";
import type { Draco } from "../decode/draco.ts";
import type { Kernels } from "../decode/kernels.ts";
import type { Manifest } from "../decode/manifest.ts";
import { decodeIds } from "../decode/packing.ts";
import { SH_REST_OF_DEGREE } from "../decode/splats.ts";
import type { Camera, FrameRange, FrameRequest, FrameUpdate, Patch } from "../seam.ts";
import type { GofBuffer } from "../store/gofBuffer.ts";
import type { Arrival } from "../store/gofTiles.ts";
import { LateOpener } from "../store/opener.ts";
import { type Committed, TileStore } from "../store/tileStore.ts";
import type { HeldTile } from "../wire/messages.ts";
import { Changes } from "./changes.ts";

/** The modules that decoding takes. */
export interface Decoders {
  readonly kernels: Kernels;
  readonly draco: Draco;
}

/** Decodes, stores and commits one scene. */
export class SceneStore {
  readonly manifest: Manifest;
  readonly store: TileStore;
  /** Newest mark of the store, over all connections. */
  mark = 0;
  shownFrame: number;
  private readonly decoders: Decoders;
  private readonly opener: LateOpener;
  private readonly changes = new Changes();
  private readonly pool = new BufferPool();
  private scene = 0;
  private shDegree = 0;

  constructor(manifest: Manifest, decoders: Decoders, startFrame: number) {
    this.manifest = manifest;
    this.decoders = decoders;
    this.opener = new LateOpener(decoders.kernels);
    this.store = new TileStore(manifest, this.opener);
    this.shownFrame = startFrame;
  }

  /** Whether tiles can be decoded. */
  get ready(): boolean {
    return this.opener.codec !== undefined;
  }

  /** The part of the codebooks that tiles need at LoD 0. Raises {@link DecodeError} or `BundleError`. */
  baseCodebooks(data: Uint8Array): void {
    this.opener.codec ??= this.codecOf(data);
  }

  /** What tiles need to be decoded. Raises {@link DecodeError} or `BundleError`. */
  codebooks(data: Uint8Array): void {
    if (this.opener.codec) this.opener.codec.extend(data);
    else this.opener.codec = this.codecOf(data);
  }

  private codecOf(codebooks: Uint8Array): TileCodec {
    return new TileCodec(this.manifest, codebooks, this.decoders.kernels, this.decoders.draco);
  }

  /** Decode layers and dequantise what they touch; what is wrong with those that are left out. */
  add(arrivals: readonly Arrival[]): DecodeError[] {
    return [...this.store.add(arrivals), ...this.store.flush()];
  }

  /** All that has come belongs to mark `number`. Raises {@link DecodeError} for marks that do not rise. */
  marked(number: number): DecodeError[] {
    if (number <= this.mark) throw new DecodeError(`mark ${number} came after mark ${this.mark}: marks rise`);
    this.mark = number;
    return this.store.mark(number);
  }

  /** The frame is whole. Raises {@link DecodeError}. */
  end(frame: number, payload: Uint8Array): void {
    const limit = Math.max(this.store.capacity(frame), 1);
    this.store.end(frame, decodeIds(payload, `removed ids of frame ${frame}`, limit));
  }

  /** Frames among which the play can jump and go on with what is held of them. */
  get kept(): FrameRange {
    return this.store.kept;
  }

  /** The viewer jumped to `frame`: forget everything. */
  reset(frame: number): void {
    this.shownFrame = frame;
    this.store.reset(frame);
  }

  held(): HeldTile[] {
    return this.store.held();
  }

  /** Free everything. */
  dispose(): void {
    this.store.dispose();
    this.opener.codec?.dispose();
  }

  /** Commit a frame; what changed, as the GPU takes it. `view` is where the viewer is, for figures. */
  frame(request: FrameRequest, view: Camera | undefined): FrameUpdate {
    const begun = performance.now();
    const { frame, basis, changedSince } = request;
    this.pool.give(request.spent ?? []);
    const share = request.share ?? 0;
    this.shownFrame = frame;
    const [store, committed] = (share ? this.store.move(frame, share) : undefined) ?? this.committed(frame, basis);
    const patches = this.patches(store, committed);
    if (changedSince && !share) {
      if (changedSince.frame === frame && changedSince.basis !== undefined) this.changes.used(changedSince.basis);
      if (this.manifest.moves) this.changes.shown(frame, store.buffer.column("means"));
    }
    const detail = view && store.detailIn(view);
    const changed = changedSince &&
      this.changes.since(changedSince, store.buffer.column("means"), store.buffer.column("log_scales"));
    return {
      frame, share, gof: committed.gof, scene: this.scene, fresh: committed.fresh,
      capacity: store.buffer.capacity, shCount: store.buffer.shCount, patches,
      changedRows: committed.rows.length, movedRows: committed.moved.length, shDegree: this.shDegree,
      missed: committed.missed, full: store.full && !committed.missed,
      lodMean: detail?.lod ?? NaN, ownError: detail?.error ?? NaN,
      bufferMs: (this.store.ahead(frame) * 1e3) / this.manifest.fps, mark: this.mark,
      ...(changed ? { changed } : {}),
      workMs: performance.now() - begun,
    };
  }

  private committed(frame: number, basis: number | undefined): [GofBuffer, Committed] {
    const [store, committed] = this.store.commit(frame, basis);
    if (committed.fresh) this.changes.clear();
    this.changes.committed(frame, basis ?? this.mark + 1, committed.rows, committed.began);
    return [store, committed];
  }

  private patches(store: GofBuffer, committed: Committed): Patch[] {
    const { buffer } = store;
    if (committed.fresh) {
      this.scene += 1;
      this.shDegree = 0;
      return buffer.capacity ? [this.patch(store, Int32Array.from({ length: buffer.capacity }, (_, i) => i), true)] : [];
    }
    const patches: Patch[] = [];
    if (committed.moved.length) patches.push(this.patch(store, committed.moved, false));
    if (committed.rows.length) patches.push(this.patch(store, committed.rows, true));
    return patches;
  }

  private patch({ buffer }: GofBuffer, rows: Int32Array, all: boolean): Patch {
    const { words, width } = buffer.packed(rows, all, this.pool);
    if (all) this.shDegree = Math.max(this.shDegree, heldBand(words, rows.length, width));
    return { motion: true, looks: all, colour: all, rows: rows.length, width, words };
  }
}

/** The highest band of harmonics with a coefficient that is not 0, of packed rows. */
function heldBand(words: Uint32Array, rows: number, width: number): number {
  const bands = SH_REST_OF_DEGREE.map((count) => 3 * count);
  let highest = 0;
  const first = 15; // row, motion 8, scales 3, colour 3
  for (let row = 0; row < rows; row++) {
    for (let k = width - 15; k >= bands[highest]!; k--) {
      if ((words[row * (1 + width) + first + k]! & 0x7fffffff) === 0) continue;
      while (bands[highest]! <= k) highest++;
      break;
    }
  }
  return highest;
}

/**
 * Default limit on the memory of a group's splats, MB: half of the device's memory, which browsers report up to 8 GB.
 * Where they report nothing, 4 GB are assumed.
 */
export function memoryMb(): number {
  const { deviceMemory = 4 } = (globalThis.navigator ?? {}) as { readonly deviceMemory?: number };
  return Math.min(Math.max(512 * deviceMemory, 512), 4096);
}

/** Refuse a scene whose groups take more than the viewer gives; one line, or undefined. */
export function tooLarge(manifest: Manifest, maxSplats: number, maxMemoryMb: number): string | undefined {
  const largest = Math.max(0, ...manifest.capacity);
  const neededMb = (4.5 * largest * 4 * (14 + 3 * SH_REST_OF_DEGREE[manifest.shDegree])) / 1e6;
  if (largest > maxSplats) return `the scene has groups of ${largest} splats, and this viewer takes ${maxSplats}`;
  if (neededMb > maxMemoryMb) {
    return `the scene has groups of ${largest} splats, which take ${Math.ceil(neededMb)} MB; this viewer gives ${maxMemoryMb}`;
  }
  return undefined;
}

