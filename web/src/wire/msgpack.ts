/**
 * The part of MessagePack that headers use, strictly: every length is checked against a bound before it is read.
 *
 * Integers and floats stay apart, as the protocol tells them apart: a float is a {@link Float}; an integer is a number
 * where that holds it exactly (up to 2^53), else a bigint.
 */

export class Float {
  readonly value: number;
  constructor(value: number) {
    this.value = value;
  }
}

export type Raw = null | boolean | string | number | bigint | Float | Uint8Array | Raw[] | RawMap;
export type RawMap = Map<string | number, Raw>;

/** Bounds of what is read. */
export interface Bounds {
  readonly text: number;
  readonly bytes: number;
  readonly list: number;
  readonly map: number;
}

/** Data that is not MessagePack, or is beyond the bounds. */
export class MsgpackError extends Error {}

const MAX_DEPTH = 1024;
const UTF8 = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });
const EXACT = 2n ** 53n;

function fail(what: string): never {
  throw new MsgpackError(what);
}

/** The first value of `data`, and where it ends. Raises {@link MsgpackError}. */
export function unpack(data: Uint8Array, bounds: Bounds): { value: Raw; end: number } {
  const reader = new Reader(data, bounds);
  const value = reader.value(0);
  return { value, end: reader.at };
}

class Reader {
  at = 0;
  private readonly data: Uint8Array;
  private readonly view: DataView;
  private readonly bounds: Bounds;

  constructor(data: Uint8Array, bounds: Bounds) {
    this.data = data;
    this.view = new DataView(data.buffer, data.byteOffset, data.byteLength);
    this.bounds = bounds;
  }

  value(depth: number): Raw {
    const byte = this.view.getUint8(this.take(1));
    if (byte < 0x80) return byte;
    if (byte < 0x90) return this.map(byte & 15, depth);
    if (byte < 0xa0) return this.list(byte & 15, depth);
    if (byte < 0xc0) return this.text(byte & 31);
    if (byte >= 0xe0) return byte - 256;
    return this.tagged(byte, depth);
  }

  private tagged(byte: number, depth: number): Raw {
    switch (byte) {
      case 0xc0: return null;
      case 0xc2: return false;
      case 0xc3: return true;
      case 0xc4: case 0xc5: case 0xc6: return this.bytes(this.unsigned(1 << (byte - 0xc4)));
      case 0xc7: case 0xc8: case 0xc9: return this.extension(this.unsigned(1 << (byte - 0xc7)));
      case 0xca: return new Float(this.view.getFloat32(this.take(4)));
      case 0xcb: return new Float(this.view.getFloat64(this.take(8)));
      case 0xcc: case 0xcd: case 0xce: return this.unsigned(1 << (byte - 0xcc));
      case 0xcf: return narrowed(this.view.getBigUint64(this.take(8)));
      case 0xd0: return this.view.getInt8(this.take(1));
      case 0xd1: return this.view.getInt16(this.take(2));
      case 0xd2: return this.view.getInt32(this.take(4));
      case 0xd3: return narrowed(this.view.getBigInt64(this.take(8)));
      case 0xd4: case 0xd5: case 0xd6: case 0xd7: case 0xd8: return this.extension(1 << (byte - 0xd4));
      case 0xd9: case 0xda: case 0xdb: return this.text(this.unsigned(1 << (byte - 0xd9)));
      case 0xdc: return this.list(this.unsigned(2), depth);
      case 0xdd: return this.list(this.unsigned(4), depth);
      case 0xde: return this.map(this.unsigned(2), depth);
      case 0xdf: return this.map(this.unsigned(4), depth);
      default: return fail("not a MessagePack format");
    }
  }

  private take(size: number): number {
    const at = this.at;
    if (size > this.data.length - at) fail("cut short");
    this.at = at + size;
    return at;
  }

  private unsigned(size: number): number {
    const at = this.take(size);
    return size === 1 ? this.view.getUint8(at) : size === 2 ? this.view.getUint16(at) : this.view.getUint32(at);
  }

  private text(size: number): string {
    if (size > this.bounds.text) fail("a text is too long");
    const at = this.take(size);
    try {
      return UTF8.decode(this.data.subarray(at, at + size));
    } catch {
      return fail("a text is not UTF-8");
    }
  }

  private bytes(size: number): Uint8Array {
    if (size > this.bounds.bytes) fail("bytes are too long");
    const at = this.take(size);
    return this.data.slice(at, at + size);
  }

  private extension(size: number): Raw {
    if (size > 0) fail("extensions are not read");
    if (this.view.getInt8(this.take(1)) === -1) fail("a timestamp of no length");
    return new Uint8Array(0);
  }

  private list(size: number, depth: number): Raw[] {
    if (size > this.bounds.list) fail("a list is too long");
    if (size && depth >= MAX_DEPTH) fail("too deep");
    const out: Raw[] = [];
    for (let i = 0; i < size; i++) out.push(this.value(depth + 1));
    return out;
  }

  private map(size: number, depth: number): RawMap {
    if (size > this.bounds.map) fail("a map is too long");
    if (size && depth >= MAX_DEPTH) fail("too deep");
    const out: RawMap = new Map();
    for (let i = 0; i < size; i++) {
      const key = this.value(depth + 1);
      const named = typeof key === "string" || typeof key === "number";
      if (!named && typeof key !== "bigint" && !(key instanceof Uint8Array)) fail("a key is neither text nor bytes nor an integer");
      const value = this.value(depth + 1);
      if (named) out.set(key, value);
    }
    return out;
  }
}

function narrowed(value: bigint): number | bigint {
  return value <= EXACT && value >= -EXACT ? Number(value) : value;
}

const ENCODER = new TextEncoder();

/** `value` in the shortest form; floats always take eight bytes. */
export function pack(value: Raw): Uint8Array {
  const writer = new Writer();
  writer.value(value);
  return writer.done();
}

class Writer {
  private data = new Uint8Array(256);
  private view = new DataView(this.data.buffer);
  private size = 0;

  done(): Uint8Array {
    return this.data.slice(0, this.size);
  }

  value(value: Raw): void {
    if (value === null) this.byte(0xc0);
    else if (typeof value === "boolean") this.byte(value ? 0xc3 : 0xc2);
    else if (typeof value === "number") this.integer(value);
    else if (typeof value === "bigint") this.wide(value);
    else if (typeof value === "string") this.text(value);
    else if (value instanceof Float) this.float(value.value);
    else if (value instanceof Uint8Array) this.bytes(value);
    else if (Array.isArray(value)) {
      this.head(value.length, 0x90, 15, 0xdc);
      for (const item of value) this.value(item);
    } else {
      this.head(value.size, 0x80, 15, 0xde);
      for (const [key, item] of value) {
        this.value(key);
        this.value(item);
      }
    }
  }

  private room(size: number): number {
    const at = this.size;
    if (at + size > this.data.length) {
      const data = new Uint8Array(Math.max(2 * this.data.length, at + size));
      data.set(this.data);
      this.data = data;
      this.view = new DataView(data.buffer);
    }
    this.size = at + size;
    return at;
  }

  private byte(value: number): void {
    const at = this.room(1); // first: it may replace the memory
    this.data[at] = value;
  }

  private float(value: number): void {
    this.byte(0xcb);
    const at = this.room(8);
    this.view.setFloat64(at, value);
  }

  private integer(value: number): void {
    if (!Number.isInteger(value)) throw new MsgpackError(`${value} is not whole`);
    if (value >= 0 && value < 0x80) this.byte(value);
    else if (value < 0 && value >= -32) this.byte(value + 256);
    else if (value >= 0 && value <= 0xffffffff) this.unsigned(value);
    else if (value < 0 && value >= -0x80000000) this.signed(value);
    else this.wide(BigInt(value));
  }

  private unsigned(value: number): void {
    if (value <= 0xff) {
      this.byte(0xcc);
      this.byte(value);
    } else if (value <= 0xffff) {
      this.byte(0xcd);
      const at = this.room(2);
      this.view.setUint16(at, value);
    } else {
      this.byte(0xce);
      const at = this.room(4);
      this.view.setUint32(at, value);
    }
  }

  private signed(value: number): void {
    if (value >= -0x80) {
      this.byte(0xd0);
      const at = this.room(1);
      this.view.setInt8(at, value);
    } else if (value >= -0x8000) {
      this.byte(0xd1);
      const at = this.room(2);
      this.view.setInt16(at, value);
    } else {
      this.byte(0xd2);
      const at = this.room(4);
      this.view.setInt32(at, value);
    }
  }

  private wide(value: bigint): void {
    if (value >= -0x80000000n && value <= 0xffffffffn) return this.integer(Number(value));
    this.byte(value < 0n ? 0xd3 : 0xcf);
    const at = this.room(8);
    if (value < 0n) this.view.setBigInt64(at, value);
    else this.view.setBigUint64(at, value);
  }

  private text(value: string): void {
    const bytes = ENCODER.encode(value);
    const size = bytes.length;
    if (size < 32) this.byte(0xa0 | size);
    else if (size <= 0xff) {
      this.byte(0xd9);
      this.byte(size);
    } else this.head(size, 0, -1, 0xda);
    const at = this.room(size);
    this.data.set(bytes, at);
  }

  private bytes(value: Uint8Array): void {
    const size = value.length;
    if (size <= 0xff) {
      this.byte(0xc4);
      this.byte(size);
    } else this.head(size, 0, -1, 0xc5);
    const at = this.room(size);
    this.data.set(value, at);
  }

  private head(size: number, short: number, most: number, long: number): void {
    if (size <= most) return this.byte(short | size);
    if (size <= 0xffff) {
      this.byte(long);
      const at = this.room(2);
      this.view.setUint16(at, size);
    } else {
      this.byte(long + 1);
      const at = this.room(4);
      this.view.setUint32(at, size);
    }
  }
}
