/** Working memory of a device: buffers that frames share, growing with what they ask for. */

import type { Gpu } from "./device.ts";
import { bufferBytes } from "./graph.ts";

/** Entries (splat, tile) that a frame may have at first. */
const LEAST_CAPACITY = 1 << 16;
const HEADROOM = 1.5;
/** Beyond this share of the capacity it grows before the next frame, so that hardly any frame is drawn twice. */
const CROWDED = 0.8;

/** Buffers of the owner `work` in the graph. `version` changes when bind groups on them have to be made anew. */
export class Workspace {
  readonly gpu: Gpu;
  version = 0;
  counts = { one: 1, splats: 1, exact_splats: 1, capacity: LEAST_CAPACITY };
  readonly #buffers = new Map<string, GPUBuffer>();

  constructor(gpu: Gpu) {
    this.gpu = gpu;
  }

  /** Make room for a scene of `splats`, and for `capacity` entries. */
  reserve(splats: number, capacity = 0, exact = false): void {
    const needed = { one: 1, splats, exact_splats: exact ? splats : 1, capacity };
    const names = Object.keys(needed) as (keyof typeof needed)[];
    if (names.every((name) => needed[name] <= this.counts[name])) return;
    for (const name of names) this.counts[name] = Math.max(this.counts[name], needed[name]);
    for (const buffer of this.#buffers.values()) buffer.destroy();
    this.#buffers.clear();
    this.version++;
  }

  /** Grow for frames that want as many entries; whether the frame that did fitted. */
  grow(wanted: number): boolean {
    const { capacity } = this.counts;
    if (wanted > CROWDED * capacity) {
      const most = Math.floor(this.gpu.maxBindingBytes / 4);
      this.reserve(1, Math.max(wanted, Math.min(Math.floor(wanted * HEADROOM), most)));
    }
    return wanted <= capacity;
  }

  get(name: string): GPUBuffer {
    let found = this.#buffers.get(name);
    if (!found) {
      const size = bufferBytes("work", this.counts)[name];
      if (size === undefined) throw new RangeError(`the graph has no buffer ${name}`);
      found = this.gpu.buffer(size, name === "dispatch" ? "indirect" : "storage");
      this.#buffers.set(name, found);
    }
    return found;
  }
}
