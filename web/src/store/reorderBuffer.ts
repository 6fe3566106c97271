/** Layers that have come before the base layer of their tile: the reorder buffer. */
import type { Key } from "./keys.ts";

const MAX_WAITING_BYTES = 8 << 20;

export interface Layer {
  readonly lod: number;
  readonly payload: Uint8Array;
}

/** Layers by tile; the oldest tile's go when more than 8 MiB wait. */
export class WaitingLayers {
  private readonly layers = new Map<Key, Layer[]>();
  private bytes = 0;

  /** Keep copies of `layers` until {@link take}. The tiles whose layers made room for them. */
  add(key: Key, layers: readonly Layer[]): Key[] {
    let kept = this.layers.get(key);
    if (!kept) this.layers.set(key, (kept = []));
    for (const { lod, payload } of layers) {
      kept.push({ lod, payload: payload.slice() });
      this.bytes += payload.length;
    }
    const gone: Key[] = [];
    while (this.bytes > MAX_WAITING_BYTES) {
      const oldest = this.layers.keys().next().value!;
      this.take(oldest);
      gone.push(oldest);
    }
    return gone;
  }

  /** The layers that waited for `key`, in the order of their arrival. */
  take(key: Key): Layer[] {
    const layers = this.layers.get(key) ?? [];
    this.layers.delete(key);
    for (const { payload } of layers) this.bytes -= payload.length;
    return layers;
  }
}
