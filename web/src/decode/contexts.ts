/** Codes by context, as `cags_common.tiles.contexts`: what a splat's neighbours have makes its own codes likely. */
import { DecodeError } from "../bytes/errors.ts";
import { check, KernelError, type Kernels } from "./kernels.ts";
import { type PackedCodes, packedBytes, unpackInto } from "./packing.ts";

export const MAX_CODE_BITS = 4;
export const MAX_PREFIX_BITS = 6;
export const MAX_LANES = 32;
/** A lane costs four bytes, and makes decoding faster. */
export const SYMBOLS_A_LANE = 1024;
const TOTAL = 4096;
const MODEL_BYTES = 48;
const DAMAGE = new Map([[16, "end too early"], [18, "the data does not end where its symbols do"]]);

/** Whether a layer has few enough bits, and few enough before it, to be coded by context. */
export function canBeModelled(layerBits: readonly number[], layer: number): boolean {
  return layerBits[layer]! <= MAX_CODE_BITS && prefixBits(layerBits, layer) <= MAX_PREFIX_BITS;
}

/** Bits of the codes below a layer. */
export function prefixBits(layerBits: readonly number[], layer: number): number {
  return layerBits.slice(0, layer).reduce((a, b) => a + b, 0);
}

/** Probabilities of one layer's codes in each context. */
export class ContextModel {
  readonly bits: number;
  /** Zero for the lowest layer. */
  readonly prefixBits: number;
  /** Of each symbol in each context [contexts, 2 ** bits], of 4096; none is zero. */
  readonly frequencies: Uint16Array;

  constructor(bits: number, prefixBits: number, weights: Uint8Array) {
    this.bits = bits;
    this.prefixBits = prefixBits;
    this.frequencies = new Uint16Array(weights.length);
    const symbols = 1 << bits;
    for (let row = 0; row < weights.length; row += symbols) this.fill(weights.subarray(row, row + symbols), row);
  }

  /** How many weights there are. */
  static size(bits: number, prefixBits: number): number {
    return (prefixBits ? (1 + (2 << bits)) << prefixBits : 2 << bits) << bits;
  }

  private fill(given: Uint8Array, row: number): void {
    const weights = given.some((weight) => weight > 0) ? given : new Uint8Array(given.length).fill(1);
    const sum = weights.reduce((a, b) => a + b, 0);
    const shares = Array.from(weights, (weight) => 1 + Math.floor((weight * (TOTAL - weights.length)) / sum));
    shares[weights.indexOf(Math.max(...weights))]! += TOTAL - shares.reduce((a, b) => a + b, 0);
    this.frequencies.set(shares, row);
  }
}

/** Of splats at integer `cells` [n, 3] in the order of their tile the two nearest [n, 2] whose codes come before; -1: none. */
export function nearest(kernels: Kernels, cells: Float32Array): Int32Array {
  return kernels.scoped((scope) => {
    const length = (cells.length / 3) * 2;
    const [from, to] = [scope.put(cells), scope.take(4 * length)];
    const status = kernels.calls.cags_codec_nearest(from, BigInt(cells.length), to, BigInt(length));
    check("cags_codec_nearest", status);
    return kernels.i32(to, length).slice();
  });
}

/** The codes [n] of one layer, and the same packed; `prefixes` [n] are the codes without it. Raises {@link DecodeError}. */
export function decodeCodes(
  kernels: Kernels, data: Uint8Array, model: ContextModel, prefixes: Uint8Array | undefined, near: Int32Array,
): { codes: Uint8Array; packed: PackedCodes } {
  const { bits } = model;
  const count = near.length / 2;
  const size = packedBytes(count, bits);
  if (data.length === size) return { codes: unpacked({ data, bits }, count), packed: { data, bits } };
  const lanes = Math.min(Math.max(Math.floor(count / SYMBOLS_A_LANE), 1), MAX_LANES);
  if (data.length > size || data.length < 4 * lanes || data.length % 2) {
    throw new DecodeError(`codes: ${data.length} bytes for ${count} codes of ${bits} bits`);
  }
  return kernels.scoped((scope) => {
    const arrays = [prefixes ? scope.put(prefixes) : 0, scope.put(near), scope.put(model.frequencies)];
    const given = scope.take(MODEL_BYTES);
    kernels.u32(given, 5).set([...arrays, bits, model.prefixBits]);
    kernels.writeLengths(given + 24, [prefixes?.length ?? 0, near.length, model.frequencies.length]);
    const [from, codes, packed] = [scope.put(data), scope.take(count), scope.take(size)];
    const { cags_codec_decode: decode } = kernels.calls;
    const status = decode(
      given, from, BigInt(data.length), BigInt(lanes), codes, BigInt(count), packed, BigInt(size),
    );
    const damage = DAMAGE.get(status);
    if (damage) throw new DecodeError(`codes: ${damage}`);
    if (status) throw new KernelError("cags_codec_decode", status);
    return { codes: kernels.u8(codes, count).slice(), packed: { data: kernels.u8(packed, size).slice(), bits } };
  });
}

/** The `count` codes [n] < 256 that are packed. */
export function unpacked(packed: PackedCodes, count: number): Uint8Array {
  const codes = new Uint32Array(count);
  unpackInto(packed, codes);
  return Uint8Array.from(codes);
}

/** Prefixes [n] of the next layer: these, followed by the `codes` [n] of this one. */
export function withLayer(prefixes: Uint8Array, codes: Uint8Array, bits: number): Uint8Array {
  return prefixes.map((prefix, i) => (prefix << bits) | codes[i]!);
}
