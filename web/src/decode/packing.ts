/** Packed codes and ascending id lists, as `cags_common.coding.packing`. */
import { DecodeError } from "../bytes/errors.ts";
import { gunzip } from "../bytes/inflate.ts";

export const MAX_SPLATS = 20_000_000;

/** Bytes that `count` values of `bits` bits take. */
export function packedBytes(count: number, bits: number): number {
  return Math.floor((count * bits + 7) / 8);
}

/** Codes as they travel, not unpacked before they are needed. */
export interface PackedCodes {
  readonly data: Uint8Array;
  readonly bits: number;
}

/** The `count` codes: `before` (zeros without) shifted by `bits`, and the new bits. `bits` is at most 8. */
export function unpackInto(packed: PackedCodes, codes: Uint32Array): void {
  const { data, bits } = packed;
  if (data.length !== packedBytes(codes.length, bits)) {
    const wanted = packedBytes(codes.length, bits);
    throw new DecodeError(`${codes.length} codes of ${bits} bits take ${wanted} bytes, not ${data.length}`);
  }
  const mask = (1 << bits) - 1;
  for (let i = 0, bit = 0; i < codes.length; i++, bit += bits) {
    const at = bit >> 3;
    const word = data[at]! | ((data[at + 1] ?? 0) << 8);
    codes[i] = (codes[i]! << bits) | ((word >> (bit & 7)) & mask);
  }
}

/**
 * Strictly ascending ids below `limit`, `expected` in number. Raises {@link DecodeError} naming `what`, for another
 * number before anything is inflated.
 */
export function decodeIds(data: Uint8Array, what: string, limit = MAX_SPLATS, expected?: number): Int32Array {
  if (data.length > 0 && data.length < 8) throw new DecodeError(`${what}: ${data.length} bytes are too few for an id list`);
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  const [count, first] = data.length ? [view.getUint32(0, true), view.getInt32(4, true)] : [0, 0];
  if (expected !== undefined && count !== expected) {
    throw new DecodeError(`${what}: claims ${count} ids for ${expected} splats`);
  }
  if (!data.length) return new Int32Array(0);
  if (!(count > 0 && count <= limit) || first < 0) {
    throw new DecodeError(`${what}: claims ${count} ids from ${first}; at most ${limit} ids from 0 are allowed`);
  }
  const raw = gunzip(data.subarray(8), 4 * (count - 1), what);
  if (raw.length !== 4 * (count - 1)) {
    throw new DecodeError(`${what}: holds ${raw.length} bytes of gaps, expected ${4 * (count - 1)}`);
  }
  return accumulated(raw, first, count, what, limit);
}

function accumulated(raw: Uint8Array, first: number, count: number, what: string, limit: number): Int32Array {
  const out = new Int32Array(count);
  const gaps = count - 1;
  let id = first;
  for (let i = 0; i < count; i++) {
    if (i) {
      const k = i - 1;
      const gap = raw[k]! + raw[gaps + k]! * 256 + raw[2 * gaps + k]! * 65536 + raw[3 * gaps + k]! * 16777216;
      id += gap + 1;
    }
    out[i] = id;
  }
  if (id >= limit) throw new DecodeError(`${what}: id ${id} is not below ${limit}`);
  return out;
}
