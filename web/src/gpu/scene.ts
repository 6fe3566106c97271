/** A scene in a device's memory: made for a group of frames, changed in part, recorded into frames. */

import type { Camera, FrameUpdate, Patch } from "../seam.ts";
import type { Gpu } from "./device.ts";
import { TooLargeError } from "./device.ts";
import { bufferBytes, build, type Counts, type Dispatch, encode, type Flags } from "./graph.ts";
import { CHANGED, CHUNK, COMPARE, COUNT, CORRECTION, type DrawOptions, tilesOf, UPDATE, VIEW, viewBytes } from "./layout.ts";
import type { Workspace } from "./workspace.ts";

/** Rows go to the device in pieces of at most this size. */
const STAGED_BYTES = 32 << 20;
/** Picture sizes whose buffers a scene keeps. */
const KEPT_SIZES = 4;
const CELL_PX = 8;

/** Splats whose harmonics lie in one buffer. */
interface Chunk {
  readonly count: number;
  readonly shRest: GPUBuffer;
  readonly job: GPUBuffer;
}

/** The buffers of pictures of one size, and the recorded steps of each kind of frame. */
export class Target {
  readonly counts: Counts;
  readonly view: GPUBuffer;
  readonly correction: GPUBuffer;
  readonly changed: GPUBuffer;
  readonly compare: GPUBuffer;
  readonly #gpu: Gpu;
  readonly #sizes: Record<string, number>;
  readonly #buffers = new Map<string, GPUBuffer>();
  readonly #steps = new Map<string, Dispatch[]>();
  #version = -1;

  constructor(gpu: Gpu, camera: Camera) {
    this.#gpu = gpu;
    const [tilesX, tilesY] = tilesOf(camera.intrinsics);
    const { widthPx, heightPx } = camera.intrinsics;
    const [cellsX, cellsY] = [Math.ceil(widthPx / CELL_PX), Math.ceil(heightPx / CELL_PX)];
    this.counts = {
      tiles: tilesX * tilesY,
      tiles_x: tilesX,
      tiles_y: tilesY,
      pixels: widthPx * heightPx,
      pixels_x: widthPx,
      pixels_y: heightPx,
      cells_x: cellsX,
      cells_y: cellsY,
      cells: 2 * cellsX * cellsY + 64, // all levels together
      one: 1,
      tile_bits: Math.max(1, 32 - Math.clz32(tilesX * tilesY)), // one tile more than there are: padding
    };
    this.#sizes = bufferBytes("view", this.counts);
    this.view = gpu.buffer(VIEW.size, "uniform");
    this.correction = gpu.buffer(CORRECTION.size, "uniform");
    this.changed = gpu.buffer(CHANGED.size, "uniform");
    this.compare = gpu.buffer(COMPARE.size, "uniform");
  }

  has(name: string): boolean {
    return name in this.#sizes;
  }

  get(name: string): GPUBuffer {
    let found = this.#buffers.get(name);
    if (!found) {
      found = this.#gpu.buffer(this.#sizes[name]);
      this.#buffers.set(name, found);
    }
    return found;
  }

  /** What `make` records, made once for a key; those of other versions of the shared buffers are dropped. */
  steps(version: number, key: string, make: () => Dispatch[]): Dispatch[] {
    if (version !== this.#version) this.#steps.clear();
    this.#version = version;
    let steps = this.#steps.get(key);
    if (!steps) this.#steps.set(key, (steps = make()));
    return steps;
  }

  destroy(): void {
    for (const buffer of [this.view, this.correction, this.changed, this.compare, ...this.#buffers.values()]) buffer.destroy();
  }
}

export class ResidentScene {
  readonly gpu: Gpu;
  readonly workspace: Workspace;
  readonly count: number;
  readonly shCount: number;
  /** How often splats were replaced. */
  changes = 0;
  /** Counts the buffers that {@link kept} made. */
  keptVersion = 0;
  readonly #buffers = new Map<string, GPUBuffer>();
  readonly #chunks: Chunk[];
  readonly #targets = new Map<string, Target>();
  readonly #kept = new Map<string, GPUBuffer>();
  #staged: GPUBuffer | null = null;
  readonly #updateJob: GPUBuffer;
  #unsorted = true;

  constructor(workspace: Workspace, update: Pick<FrameUpdate, "capacity" | "shCount">) {
    this.workspace = workspace;
    this.gpu = workspace.gpu;
    this.count = update.capacity;
    this.shCount = update.shCount;
    const sizes = bufferBytes("scene", { splats: this.count });
    if (Math.max(...Object.values(sizes)) > this.gpu.maxBindingBytes)
      throw new TooLargeError(`a scene of ${this.count} splats is more than this graphics processor holds`);
    workspace.reserve(this.count, Math.min(4 * this.count, this.gpu.maxBindingBytes / 16));
    for (const [name, size] of Object.entries(sizes)) this.#buffers.set(name, this.gpu.buffer(size));
    this.#updateJob = this.gpu.buffer(UPDATE.size, "uniform");
    this.#chunks = this.#chunked();
  }

  #chunked(): Chunk[] {
    const words = 3 * this.shCount;
    const most = words ? Math.max(1, Math.floor(this.gpu.maxBindingBytes / (4 * words))) : this.count;
    const chunks: Chunk[] = [];
    for (let first = 0; first < this.count; first += most) {
      const count = Math.min(most, this.count - first);
      chunks.push({ count, shRest: this.gpu.buffer(4 * words * count), job: this.gpu.uniform(CHUNK.pack({ first, count })) });
    }
    return chunks;
  }

  destroy(): void {
    for (const buffer of [...this.#buffers.values(), ...this.#kept.values(), this.#updateJob]) buffer.destroy();
    for (const { shRest } of this.#chunks) shRest.destroy();
    for (const target of this.#targets.values()) target.destroy();
    this.#staged?.destroy();
  }

  /** Replace rows; the bytes that went to the device. */
  change(patches: readonly Patch[]): number {
    let bytes = 0;
    for (const patch of patches) {
      if (!patch.rows) continue;
      const words = 1 + patch.width;
      const piece = Math.max(1, Math.floor(Math.min(STAGED_BYTES, this.gpu.maxBindingBytes) / (4 * words)));
      for (let start = 0; start < patch.rows; start += piece) {
        const rows = Math.min(piece, patch.rows - start);
        this.#stage(patch, patch.words.subarray(start * words, (start + rows) * words), rows);
      }
      bytes += patch.words.byteLength;
    }
    if (bytes) {
      this.#unsorted = true;
      this.changes++;
    }
    return bytes;
  }

  #stage(patch: Patch, words: Uint32Array<ArrayBuffer>, rows: number): void {
    const { device } = this.gpu;
    if (!this.#staged || this.#staged.size < words.byteLength) {
      this.#staged?.destroy();
      this.#staged = this.gpu.buffer(words.byteLength);
    }
    device.queue.writeBuffer(this.#staged, 0, words);
    device.queue.writeBuffer(this.#updateJob, 0, UPDATE.pack({ rows, sh_words: 3 * this.shCount, width: patch.width }));
    const encoder = device.createCommandEncoder();
    const flags = { motion: patch.motion, looks: patch.looks, colour: patch.colour };
    for (const chunk of this.#chunks) {
      const named: Named = { staged: this.#staged, update_job: this.#updateJob, chunk: chunk.job, sh_rest: chunk.shRest };
      encode(encoder, build(this.gpu, "update", { rows }, flags, (name) => named[name] ?? this.#buffers.get(name)!));
    }
    device.queue.submit([encoder.finish()]);
  }

  /** A buffer of the scene's own, made when it is first asked for or was smaller. */
  kept(name: string, size: number): GPUBuffer {
    let held = this.#kept.get(name);
    if (!held || held.size < size) {
      held?.destroy();
      held = this.gpu.buffer(size);
      this.#kept.set(name, held);
      this.keptVersion++;
    }
    return held;
  }

  /** The buffers of pictures of the camera's size; `role` keeps two of one size apart. */
  target(camera: Camera, role = ""): Target {
    const key = `${camera.intrinsics.widthPx}x${camera.intrinsics.heightPx} ${role}`;
    const found = this.#targets.get(key) ?? new Target(this.gpu, camera);
    this.#targets.delete(key);
    this.#targets.set(key, found); // the last used is the last to go
    for (const [oldest, target] of this.#targets) {
      if (this.#targets.size <= KEPT_SIZES) break;
      target.destroy();
      this.#targets.delete(oldest);
    }
    return found;
  }

  /** Record a frame: afterwards the target holds picture and, unless `flat`, depth. */
  record(encoder: GPUCommandEncoder, camera: Camera, options: DrawOptions, role = "", compact = false): Target {
    const exact = options.exactness === "exact";
    this.workspace.reserve(this.count, 0, exact);
    const target = this.target(camera, role);
    const { capacity } = this.workspace.counts;
    const view = viewBytes(camera, options, { count: this.count, shCount: this.shCount, capacity });
    this.gpu.device.queue.writeBuffer(target.view, 0, view);
    if (this.#unsorted) encode(encoder, this.#hashSteps(target));
    encode(encoder, this.#frameSteps(target, frameFlags(options, compact)));
    return target;
  }

  /** What was recorded has been submitted, and what it drew is whole. */
  submitted(): void {
    this.#unsorted = false;
  }

  #hashSteps(target: Target): Dispatch[] {
    const named: Named = { count_job: this.gpu.uniform(COUNT.pack({ count: this.count })) };
    return target.steps(this.workspace.version, "hash", () =>
      build(this.gpu, "hash", this.#counts(target), {}, (name) => this.#find(target, name, named)),
    );
  }

  #frameSteps(target: Target, flags: Flags): Dispatch[] {
    return target.steps(this.workspace.version, `frame ${flags.packed} ${flags.compact}`, () => {
      const counts = this.#counts(target);
      const steps = this.#chunks.flatMap((chunk) => {
        const named: Named = { view: target.view, chunk: chunk.job, sh_rest: chunk.shRest };
        const own = { ...counts, chunk_splats: chunk.count };
        return build(this.gpu, "project", own, flags, (name) => this.#find(target, name, named));
      });
      const drawn = build(this.gpu, "draw", counts, flags, (name) => this.#find(target, name, { view: target.view }));
      return [...steps, ...drawn];
    });
  }

  #counts(target: Target): Counts {
    return { ...this.workspace.counts, ...target.counts, splats: this.count };
  }

  #find(target: Target, name: string, named: Named): GPUBuffer {
    return named[name] ?? this.#buffers.get(name) ?? (target.has(name) ? target.get(name) : this.workspace.get(name));
  }
}

export type Named = Readonly<Record<string, GPUBuffer>>;

/** What chooses the steps and constants of a frame. */
export function frameFlags({ exactness }: Pick<DrawOptions, "exactness">, compact: boolean): Flags {
  return { packed: exactness !== "exact", compact, slots: false, contribution: false };
}
