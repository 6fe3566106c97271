/** Media that has come over the wire and waits for its decoder, in order; as `cags_client.playback`. */
import type { SessionEvent } from "../wire/session.ts";
import type { HeldTile } from "../wire/messages.ts";

/** From here on data comes over another connection, which was told that `inventory` is held. */
export interface Restarted {
  readonly type: "restarted";
  readonly inventory: readonly HeldTile[];
}

export type DataEvent = Extract<SessionEvent, { type: "tile" | "reference" | "frame_end" | "mark" }> | Restarted;

/** Media that may wait; beyond it nothing more is acknowledged until it has been decoded. */
export const MAX_UNDECODED_BYTES = 32 << 20;

/** Events and bytes decoded in one go: few enough that a frame which is asked for does not wait for long. */
const BATCH_EVENTS = 32;
const BATCH_BYTES = 48 << 10;

export class DecodeQueue {
  undecodedBytes = 0;
  private waiting: DataEvent[] = [];

  get length(): number {
    return this.waiting.length;
  }

  add(event: DataEvent): void {
    this.waiting.push(event);
    this.undecodedBytes += sizeOf(event);
  }

  /** The next events, up to a mark or a new connection, which end a batch; without `tiles` it ends before the first. */
  take(tiles: boolean): DataEvent[] {
    const batch: DataEvent[] = [];
    let bytes = 0;
    for (const event of this.waiting) {
      if ((event.type === "tile" && !tiles) || batch.length >= BATCH_EVENTS || bytes >= BATCH_BYTES) break;
      batch.push(event);
      bytes += sizeOf(event);
      if (event.type === "mark" || event.type === "restarted") break;
    }
    this.waiting.splice(0, batch.length);
    this.undecodedBytes -= bytes;
    return batch;
  }

  /** What waits is of no use any more, but for the beginnings of connections, by which marks are told apart. */
  clear(): void {
    this.waiting = this.waiting.filter((event) => event.type === "restarted");
    this.undecodedBytes = 0;
  }

  /** What a store holds once everything here is decoded into it; a layer without the one below it is not held. */
  held(stored: readonly HeldTile[]): HeldTile[] {
    const out = new Map(stored.map((t) => [`${t.frame}/${t.tile}`, t]));
    for (const event of this.waiting) {
      if (event.type !== "tile") continue;
      const { frame, tile, from_lod, to_lod } = event.message;
      const lods = out.get(`${frame}/${tile}`)?.lods ?? 0;
      if (from_lod <= lods) out.set(`${frame}/${tile}`, { frame, tile, lods: Math.max(lods, to_lod) });
    }
    return [...out.values()];
  }
}

function sizeOf(event: DataEvent): number {
  return "payload" in event ? event.payload.length : 0;
}
