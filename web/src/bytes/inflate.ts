/**
 * Inflate (RFC 1951) and gzip (RFC 1952) with a bound on what comes out, strict about what follows: as zlib is called by
 * `cags_common.coding.packing`. The browser's DecompressionStream is asynchronous, and says nothing of bytes left over.
 */
import { crc32 } from "./crc32.ts";
import { DecodeError } from "./errors.ts";

const LENGTH_BASE = [3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258];
const LENGTH_BITS = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0];
const DISTANCE_BASE = [
  1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193,
  12289, 16385, 24577,
];
const DISTANCE_BITS = [0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 8, 9, 9, 10, 10, 11, 11, 12, 12, 13, 13];
const ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
const MAX_BITS = 15;

class InflateError extends Error {}

/** A canonical Huffman code: a table by the next `bits` bits, whose entries are symbol x 16 + length (0: none). */
interface Code {
  readonly table: Uint16Array;
  readonly bits: number;
}

/** Raises for lengths that say more codes than there are, or fewer (but for one code alone, as zlib allows). */
function makeCode(lengths: Uint8Array, mayBeShort: boolean): Code {
  const count = new Uint16Array(MAX_BITS + 1);
  for (const length of lengths) count[length]!++;
  let bits = MAX_BITS;
  while (bits > 0 && !count[bits]) bits--;
  if (!bits) {
    if (mayBeShort) return { table: new Uint16Array(2), bits: 1 };
    throw new InflateError("a code without symbols");
  }
  let left = 1;
  const next = new Uint16Array(MAX_BITS + 2);
  for (let length = 1, code = 0; length <= MAX_BITS; length++) {
    left = (left << 1) - count[length]!;
    if (left < 0) throw new InflateError("too many codes");
    next[length] = code;
    code = (code + count[length]!) << 1;
  }
  if (left > 0 && !(mayBeShort && bits === 1)) throw new InflateError("too few codes");
  const table = new Uint16Array(1 << bits);
  for (let symbol = 0; symbol < lengths.length; symbol++) {
    const length = lengths[symbol]!;
    if (!length) continue;
    let reversed = 0;
    for (let code = next[length]!++, i = 0; i < length; i++, code >>= 1) reversed = (reversed << 1) | (code & 1);
    for (let at = reversed; at < table.length; at += 1 << length) table[at] = (symbol << 4) | length;
  }
  return { table, bits };
}

function fixedCodes(): [Code, Code] {
  const lengths = new Uint8Array(288).map((_, i) => (i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8));
  return [makeCode(lengths, false), makeCode(new Uint8Array(32).fill(5), false)];
}

let fixed: [Code, Code] | undefined;

class Inflater {
  at: number;
  out: Uint8Array<ArrayBuffer>;
  size = 0;
  private hold = 0;
  private held = 0;
  private readonly data: Uint8Array;
  private readonly limit: number;

  constructor(data: Uint8Array, at: number, limit: number, hint: number) {
    this.data = data;
    this.at = at;
    this.limit = limit;
    this.out = new Uint8Array(Math.min(hint, limit));
  }

  /** Until the last block has ended; afterwards {@link at} is the first byte that is not part of it. */
  run(): void {
    for (let last = 0; !last; ) {
      last = this.bits(1);
      const kind = this.bits(2);
      if (kind === 0) this.stored();
      else if (kind === 1) this.coded(...(fixed ??= fixedCodes()));
      else if (kind === 2) this.coded(...this.codes());
      else throw new InflateError("an unknown block");
    }
    this.at -= this.held >> 3;
  }

  private need(count: number): void {
    while (this.held < count) {
      if (this.at >= this.data.length) throw new InflateError("cut short");
      this.hold |= this.data[this.at++]! << this.held;
      this.held += 8;
    }
  }

  private bits(count: number): number {
    if (!count) return 0;
    this.need(count);
    const value = this.hold & ((1 << count) - 1);
    this.hold >>>= count;
    this.held -= count;
    return value;
  }

  private symbol(code: Code): number {
    while (this.held < code.bits && this.at < this.data.length) {
      this.hold |= this.data[this.at++]! << this.held;
      this.held += 8;
    }
    const entry = code.table[this.hold & ((1 << code.bits) - 1)]!;
    const length = entry & 15;
    if (!length) throw new InflateError("an invalid code");
    if (length > this.held) throw new InflateError("cut short");
    this.hold >>>= length;
    this.held -= length;
    return entry >> 4;
  }

  private room(count: number): void {
    const wanted = this.size + count;
    if (wanted > this.limit) throw new InflateError("more comes out than is allowed");
    if (wanted <= this.out.length) return;
    const out = new Uint8Array(Math.min(this.limit, Math.max(2 * this.out.length, wanted, 64)));
    out.set(this.out.subarray(0, this.size));
    this.out = out;
  }

  private stored(): void {
    this.bits(this.held & 7);
    const length = this.bits(16);
    if ((this.bits(16) ^ 0xffff) !== length) throw new InflateError("a stored block of two lengths");
    this.at -= this.held >> 3;
    this.hold = this.held = 0;
    if (length > this.data.length - this.at) throw new InflateError("cut short");
    this.room(length);
    this.out.set(this.data.subarray(this.at, this.at + length), this.size);
    this.at += length;
    this.size += length;
  }

  private codes(): [Code, Code] {
    const literals = this.bits(5) + 257;
    const distances = this.bits(5) + 1;
    const meta = new Uint8Array(19);
    for (let i = this.bits(4) + 4, k = 0; k < i; k++) meta[ORDER[k]!] = this.bits(3);
    if (literals > 286 || distances > 30) throw new InflateError("too many symbols");
    const lengths = this.lengths(makeCode(meta, false), literals + distances);
    if (!lengths[256]) throw new InflateError("a code without an end");
    return [makeCode(lengths.subarray(0, literals), true), makeCode(lengths.subarray(literals), true)];
  }

  private lengths(code: Code, count: number): Uint8Array {
    const out = new Uint8Array(count);
    for (let i = 0; i < count; ) {
      const symbol = this.symbol(code);
      if (symbol < 16) {
        out[i++] = symbol;
        continue;
      }
      if (symbol === 16 && !i) throw new InflateError("a repeat of nothing");
      const value = symbol === 16 ? out[i - 1]! : 0;
      const times = symbol === 16 ? 3 + this.bits(2) : symbol === 17 ? 3 + this.bits(3) : 11 + this.bits(7);
      if (times > count - i) throw new InflateError("too many lengths");
      out.fill(value, i, (i += times));
    }
    return out;
  }

  private coded(literals: Code, distances: Code): void {
    for (;;) {
      const symbol = this.symbol(literals);
      if (symbol === 256) return;
      if (symbol < 256) {
        this.room(1);
        this.out[this.size++] = symbol;
      } else {
        this.copy(symbol - 257, distances);
      }
    }
  }

  private copy(which: number, distances: Code): void {
    if (which >= LENGTH_BASE.length) throw new InflateError("an invalid length");
    const length = LENGTH_BASE[which]! + this.bits(LENGTH_BITS[which]!);
    const far = this.symbol(distances);
    if (far >= DISTANCE_BASE.length) throw new InflateError("an invalid distance");
    const distance = DISTANCE_BASE[far]! + this.bits(DISTANCE_BITS[far]!);
    if (distance > this.size) throw new InflateError("a distance before the beginning");
    this.room(length);
    const { out } = this;
    for (let i = this.size, end = this.size + length; i < end; i++) out[i] = out[i - distance]!;
    this.size += length;
  }
}

/** Inverse of Python's `squeeze` for data of `size` bytes. Raises {@link DecodeError} naming `what`. */
export function unsqueeze(data: Uint8Array, size: number, what: string): Uint8Array {
  if (data.length === size) return data.slice();
  if (data.length > size) throw new DecodeError(`${what}: takes ${data.length} bytes, at most ${size} are expected`);
  const machine = new Inflater(data, 0, size, size);
  try {
    machine.run();
  } catch (error) {
    if (!(error instanceof InflateError)) throw error;
    throw new DecodeError(`${what}: cannot be inflated (${error.message})`);
  }
  if (machine.size !== size || machine.at !== data.length) {
    throw new DecodeError(`${what}: inflates to other than its ${size} bytes`);
  }
  return machine.out;
}

/** What one gzip member holds, at most `limit` bytes. Raises {@link DecodeError} naming `what`. */
export function gunzip(data: Uint8Array, limit: number, what: string): Uint8Array {
  const machine = new Inflater(data, gzipHeader(data, what), limit, Math.min(limit, 4 * data.length));
  try {
    machine.run();
  } catch (error) {
    if (!(error instanceof InflateError)) throw error;
    throw new DecodeError(`${what}: is not valid gzip data (${error.message})`);
  }
  const out = machine.out.subarray(0, machine.size);
  if (data.length !== machine.at + 8) throw new DecodeError(`${what}: gzip data is cut short or followed by other bytes`);
  const view = new DataView(data.buffer, data.byteOffset + machine.at, 8);
  if (view.getUint32(0, true) !== crc32(out) || view.getUint32(4, true) !== out.length) {
    throw new DecodeError(`${what}: is not valid gzip data (its checksum does not match)`);
  }
  return out;
}

function gzipHeader(data: Uint8Array, what: string): number {
  const flags = data[3] ?? 0;
  if (data.length < 18 || data[0] !== 0x1f || data[1] !== 0x8b || data[2] !== 8 || flags & 0xe0) {
    throw new DecodeError(`${what}: is not valid gzip data`);
  }
  let at = 10;
  if (flags & 4) at += 2 + (data[at]! | (data[at + 1]! << 8));
  for (const named of [8, 16]) {
    if (!(flags & named)) continue;
    while (at < data.length && data[at]) at++;
    at++;
  }
  if (flags & 2) at += 2;
  return at;
}
