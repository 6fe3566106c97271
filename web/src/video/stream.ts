/** The reference video: references in the order they came, decoded; a gap asks for a key picture. */

import type { Reference } from "../seam.ts";
import { H264Decoder } from "./decoder.ts";

/** A lost reference video is asked for again after this long. */
const RETRY_MS = 250;

export interface VideoEvents {
  /** A reference is there; `coded` [h, w, 3] in [0, 1], null where it says nothing. */
  decoded(reference: Reference, coded: Float32Array<ArrayBuffer> | null): void;
  /** The video is broken after picture `seq`. */
  broken(seq: number): void;
}

export class ReferenceVideo {
  errors = 0;
  readonly #events: VideoEvents;
  readonly #decoder = new H264Decoder();
  #chain: Promise<void> = Promise.resolve();
  #generation = 0;
  #connection = 0;
  #lastSeq = 0;
  #lastDecoded = 0;
  #askedMs = -Infinity;

  constructor(events: VideoEvents) {
    this.#events = events;
  }

  add(reference: Reference): void {
    const generation = this.#generation;
    this.#chain = this.#chain.then(() => (generation === this.#generation ? this.#next(reference, generation) : this.#follow(reference)));
  }

  /** References that have come are of a place that was left: they are decoded, as later ones need them, and not told. */
  forget(): void {
    this.#generation++;
  }

  async #follow(reference: Reference): Promise<void> {
    await this.#decoded(reference);
  }

  async #next(reference: Reference, generation: number): Promise<void> {
    if (reference.kind === "nothing") {
      if (generation === this.#generation) this.#events.decoded(reference, null);
      return;
    }
    const coded = await this.#decoded(reference);
    if (coded && generation === this.#generation) this.#events.decoded(reference, coded);
  }

  async #decoded(reference: Reference): Promise<Float32Array<ArrayBuffer> | null> {
    if (reference.kind === "nothing") return null;
    if (reference.connection !== this.#connection) {
      this.#connection = reference.connection;
      this.#lastSeq = this.#lastDecoded = 0;
      this.#decoder.reset();
    }
    const { seq, idr } = reference;
    if (seq <= this.#lastSeq && !idr) return null; // late: the decoder is past it
    if (seq !== this.#lastSeq + 1 && !idr) this.#decoder.reset();
    this.#lastSeq = seq;
    if (!this.#decoder.started && !idr) {
      this.#ask();
      return null;
    }
    const { widthPx, heightPx } = reference.camera.intrinsics;
    try {
      const coded = await this.#decoder.decode(reference.data, idr, widthPx, heightPx);
      this.#lastDecoded = seq;
      return coded;
    } catch {
      this.errors++;
      this.#ask();
      return null;
    }
  }

  #ask(): void {
    if (performance.now() - this.#askedMs < RETRY_MS) return;
    this.#askedMs = performance.now();
    this.#events.broken(this.#lastDecoded);
  }
}
