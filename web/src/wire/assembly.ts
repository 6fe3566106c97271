/** The client's side of fragments: which packets arrived, and messages put together from them. All of it bounded. */
import { ProtocolError } from "../bytes/errors.ts";
import * as limits from "./limits.ts";
import type { Blob, Fragment, SeqRange } from "./messages.ts";

/** Numbers of the packets that arrived, as ranges, newest first; the newest {@link limits.MAX_ACK_RANGES} are kept. */
export class ReceivedPackets {
  private readonly all: { first: number; last: number }[] = [];

  get ranges(): readonly SeqRange[] {
    return this.all.map((range) => ({ ...range }));
  }

  /** Note packet `seq`; false if it came before or is too old to tell. */
  add(seq: number): boolean {
    const all = this.all;
    if (all.length >= limits.MAX_ACK_RANGES && seq < all[all.length - 1]!.first - 1) return false;
    for (const [index, known] of all.entries()) {
      if (known.first <= seq && seq <= known.last) return false;
      if (seq > known.last) {
        this.insert(index, seq);
        return true;
      }
    }
    this.insert(all.length, seq);
    return true;
  }

  /** Put `seq` before range `index`, merging with the neighbours that it touches. */
  private insert(index: number, seq: number): void {
    const all = this.all;
    let first = seq;
    let last = seq;
    if (index < all.length && all[index]!.last === seq - 1) first = all.splice(index, 1)[0]!.first;
    if (index > 0 && all[index - 1]!.first === seq + 1) {
      index -= 1;
      last = all.splice(index, 1)[0]!.last;
    }
    all.splice(index, 0, { first, last });
    all.length = Math.min(all.length, limits.MAX_ACK_RANGES);
  }
}

/** Chunks of one message or blob of `total` bytes, in any order of arrival. */
export class Partial {
  received = 0;
  readonly total: number;
  private readonly chunks = new Map<number, Uint8Array>();

  constructor(total: number) {
    this.total = total;
  }

  holds(offset: number): boolean {
    return this.chunks.has(offset);
  }

  /** Keep a copy of `chunk`. */
  add(offset: number, chunk: Uint8Array): void {
    this.chunks.set(offset, chunk.slice());
    this.received += chunk.length;
  }

  /** All of it. Raises {@link ProtocolError} naming `what` for chunks that overlap or do not add up. */
  joined(what: string): Uint8Array<ArrayBuffer> {
    const out = new Uint8Array(this.received);
    let position = 0;
    for (const [offset, chunk] of [...this.chunks].sort((a, b) => a[0] - b[0])) {
      if (offset !== position) {
        throw new ProtocolError(`${what}: its parts overlap or leave a gap at byte ${Math.min(offset, position)}`);
      }
      out.set(chunk, position);
      position += chunk.length;
    }
    if (position !== this.total) {
      throw new ProtocolError(`${what}: its parts have ${position} bytes, its total is ${this.total}`);
    }
    return out;
  }
}

/** Puts messages together from fragments in any order. */
export class Assembler {
  /** Bytes held of messages that are not complete. */
  partialBytes = 0;
  private readonly partials = new Map<number, Partial>();
  private readonly closed = new Set<number>();

  /** Take a fragment; the whole encoded message once it is complete. Raises {@link ProtocolError}. */
  add(fragment: Fragment, chunk: Uint8Array): Uint8Array | undefined {
    const { ident, total, offset } = fragment;
    if (this.closed.has(ident)) return undefined;
    if (!total) {
      this.close(ident);
      return chunk;
    }
    let partial = this.partials.get(ident);
    if (!partial) this.partials.set(ident, (partial = new Partial(total)));
    if (partial.total !== total || partial.holds(offset)) {
      throw new ProtocolError(`fragment of message ${ident} contradicts an earlier one`);
    }
    partial.add(offset, chunk);
    this.partialBytes += chunk.length;
    if (partial.received >= partial.total) {
      this.close(ident);
      return partial.joined(`message ${ident}`);
    }
    this.bound();
    return undefined;
  }

  /** Forget a message; later fragments of it are ignored. */
  abandon(ident: number): void {
    this.close(ident);
  }

  private close(ident: number): void {
    const partial = this.partials.get(ident);
    this.partials.delete(ident);
    if (partial) this.partialBytes -= partial.received;
    this.closed.add(ident); // one that is there keeps its place in the order
    if (this.closed.size > 4 * limits.MAX_PARTIAL_MESSAGES) this.closed.delete(this.closed.values().next().value!);
  }

  private bound(): void {
    while (this.partials.size > limits.MAX_PARTIAL_MESSAGES || this.partialBytes > limits.MAX_PARTIAL_BYTES) {
      this.close(this.partials.keys().next().value!);
    }
  }
}

export const CODEBOOKS_BLOB = "codebooks";
/** The part of them that tiles need at LoD 0, for a first picture. */
export const BASE_CODEBOOKS_BLOB = "base-codebooks";
const MAX_BLOBS_AT_ONCE = 8;

/** Collects chunks of blobs in any order; memory follows what was received, not what was promised. */
export class BlobAssembler {
  private readonly partials = new Map<string, Partial>();
  private bytes = 0;

  /** Take a chunk; the whole blob once it is complete. A repeated chunk is ignored. Raises {@link ProtocolError}. */
  add(blob: Blob, chunk: Uint8Array): Uint8Array<ArrayBuffer> | undefined {
    const name = `blob '${blob.name}'`;
    let partial = this.partials.get(blob.name);
    if (!partial) this.partials.set(blob.name, (partial = new Partial(blob.total)));
    if (this.partials.size > MAX_BLOBS_AT_ONCE) {
      throw new ProtocolError(`${name}: more than ${MAX_BLOBS_AT_ONCE} blobs half sent at once`);
    }
    if (partial.total !== blob.total) {
      throw new ProtocolError(`${name}: has a total of ${blob.total} bytes, in an earlier chunk ${partial.total}`);
    }
    if (!partial.holds(blob.offset)) {
      this.bytes += chunk.length;
      partial.add(blob.offset, chunk);
    }
    if (this.bytes > limits.MAX_BLOB_BYTES) {
      throw new ProtocolError(`${name}: more than ${limits.MAX_BLOB_BYTES} bytes half sent`);
    }
    if (partial.received < partial.total) return undefined;
    this.partials.delete(blob.name);
    this.bytes -= partial.received;
    return partial.joined(name);
  }
}
