/**
 * The strict encoding of messages, as `cags_protocol.wire.encoding`: bytes to checked values and back. Headers are read in
 * either form, with text keys or with numbers; which one is written depends on the message.
 */
import { crc32 } from "../bytes/crc32.ts";
import { ProtocolError } from "../bytes/errors.ts";
import * as limits from "./limits.ts";
import { type Message, SPECS, type Spec, type Tag } from "./messages.ts";
import { MsgpackError, pack, type Raw, type RawMap, unpack } from "./msgpack.ts";

/** A message that did not arrive as it was sent, or never was one: its CRC cannot be found or does not match. */
export class DamagedError extends ProtocolError {
  override name = "DamagedError";
}

/** A hello of a protocol version that is not spoken here. */
export class VersionError extends ProtocolError {
  override name = "VersionError";
}

export interface Decoded {
  readonly message: Message;
  /** A view into the data; empty where the payload is a field of the message. */
  readonly payload: Uint8Array;
}

const EMPTY = new Uint8Array(0);
const BOUNDS = { text: limits.MAX_TEXT_BYTES, bytes: limits.MAX_HEADER_BYTES, list: limits.MAX_EVICTED_TILES, map: 64 };
/** Keys of the type and of the CRC in headers with numbers. */
const [TYPE, CRC] = [0, 127];
/** What stands before the CRC: its key, and the head of a uint32. */
const [TEXT_MARK, NUMBER_MARK] = [[0xa3, 0x63, 0x72, 0x63, 0xce], [0x7f, 0xce]];
const BY_CODE = new Map<number, Tag>(Object.entries(SPECS).flatMap(([tag, { code }]) => (code === undefined ? [] : [[code, tag as Tag]])));

/** The wire form of `message` and its payload. Raises {@link ProtocolError} for values that must not travel. */
export function encode(message: Message, payload: Uint8Array = EMPTY): Uint8Array<ArrayBuffer> {
  const spec = SPECS[message.type];
  const values = message as unknown as Record<string, unknown>;
  if (spec.payload === "opaque") checkPayload(message, payload.length);
  else if (payload.length) throw new ProtocolError(`${message.type} carries no separate payload`);
  else if (spec.payload !== "none") payload = values[spec.payload] as Uint8Array;
  const { code } = spec;
  const header: RawMap = new Map<string | number, Raw>([code === undefined ? ["type", message.type] : [TYPE, code]]);
  for (const [i, { name, kind, fallback }] of spec.fields.entries()) {
    const value = values[name];
    if (fallback === undefined || !isFallback(value, fallback)) header.set(code === undefined ? name : i + 1, kind.pack(value, name));
  }
  header.set(code === undefined ? "crc" : CRC, 0xffffffff); // the widest integer form; its value is written below, over these four bytes
  const head = pack(header);
  if (head.length > limits.MAX_HEADER_BYTES) {
    throw new ProtocolError(`${message.type}: header of ${head.length} bytes, at most ${limits.MAX_HEADER_BYTES}`);
  }
  const out = new Uint8Array(head.length + payload.length);
  out.set(head);
  out.set(payload, head.length);
  const crc = crc32(payload, crc32(out.subarray(0, head.length - 4)));
  new DataView(out.buffer).setUint32(head.length - 4, crc);
  return out;
}

function isFallback(value: unknown, fallback: unknown): boolean {
  return Array.isArray(fallback) ? Array.isArray(value) && value.length === 0 : value === fallback;
}

/** Message and payload of one wire message. Raises {@link ProtocolError}, and nothing else. */
export function decode(data: Uint8Array): Decoded {
  const { header, end } = readHeader(data);
  const payload = data.subarray(end);
  const mark = header.has(TYPE) ? NUMBER_MARK : TEXT_MARK;
  if (!mark.every((byte, i) => data[end - 4 - mark.length + i] === byte)) throw new DamagedError("header does not end with its crc");
  const told = new DataView(data.buffer, data.byteOffset + end - 4, 4).getUint32(0);
  if (crc32(payload, crc32(data.subarray(0, end - 4))) !== told) {
    throw new DamagedError("crc does not match: the message was damaged on its way");
  }
  const tag = tagOf(header);
  if (tag === "hello") checkVersion(header);
  const spec = SPECS[tag];
  const message = build(tag, spec, header, payload);
  if (spec.payload !== "opaque") return { message, payload: EMPTY };
  checkPayload(message, payload.length);
  return { message, payload };
}

function tagOf(header: RawMap): Tag {
  const numbered = header.has(TYPE);
  const found = header.get(numbered ? TYPE : "type");
  if (numbered && typeof found === "number" && BY_CODE.has(found)) return BY_CODE.get(found)!;
  if (!numbered && typeof found === "string" && Object.hasOwn(SPECS, found)) return found as Tag;
  throw new ProtocolError(`type = ${String(found).slice(0, 60)} is not a known message`);
}

function readHeader(data: Uint8Array): { header: RawMap; end: number } {
  try {
    const { value, end } = unpack(data.subarray(0, limits.MAX_HEADER_BYTES), BOUNDS);
    if (!(value instanceof Map)) throw new DamagedError("header is not a map");
    return { header: value, end };
  } catch (error) {
    if (error instanceof MsgpackError) throw new DamagedError(`header is not readable (${error.message})`);
    throw error;
  }
}

function checkVersion(header: RawMap): void {
  const version = header.get("version");
  const whole = typeof version === "bigint" || typeof version === "number";
  if (whole && !limits.SUPPORTED_VERSIONS.includes(Number(version))) {
    throw new VersionError(`version = ${version} is not spoken here`);
  }
}

function build(tag: Tag, spec: Spec, header: RawMap, payload: Uint8Array): Message {
  const values: Record<string, unknown> = { type: tag };
  const numbered = header.has(TYPE);
  for (const [i, { name, kind, fallback }] of spec.fields.entries()) {
    const raw = header.get(numbered ? i + 1 : name);
    if (raw !== undefined) values[name] = kind.unpack(raw, name);
    else if (fallback === undefined) throw new ProtocolError(`${tag}: ${name} is missing`);
    else values[name] = fallback;
  }
  if (spec.payload === "none" && payload.length) {
    throw new ProtocolError(`${tag} carries no payload, but ${payload.length} bytes follow`);
  }
  if (spec.payload !== "none" && spec.payload !== "opaque") values[spec.payload] = payload.slice();
  return values as unknown as Message;
}

/** Lengths that a header promises must be the payload's. */
function checkPayload(message: Message, size: number): void {
  if (message.type === "tile") {
    const count = message.to_lod - message.from_lod;
    const { length } = message.crcs;
    if (count < 1 || message.sizes.length !== count || (length && length !== count)) {
      const range = `${message.from_lod}..${message.to_lod}`;
      const got = `${message.sizes.length} and ${length}`;
      throw new ProtocolError(`tile: LoDs ${range} need ${Math.max(count, 1)} sizes and as many crcs or none, got ${got}`);
    }
    const sum = message.sizes.reduce((a, b) => a + b, 0);
    if (sum !== size) throw new ProtocolError(`tile: sizes add up to ${sum} bytes, the payload has ${size}`);
  } else if (message.type === "blob") {
    checkPart("blob", message.offset, size, message.total, message.total === 0);
  } else if (message.type === "fragment") {
    checkPart("fragment", message.offset, size, message.total || size, false);
  }
}

function checkPart(tag: string, offset: number, size: number, total: number, mayBeEmpty: boolean): void {
  if (offset + size > total || !(size || mayBeEmpty)) {
    throw new ProtocolError(`${tag}: bytes ${offset} + ${size} do not lie in a total of ${total}`);
  }
}

/** The payload of each level of a tile, without copying. */
export function splitLayers(sizes: readonly number[], payload: Uint8Array): Uint8Array[] {
  let start = 0;
  return sizes.map((size) => payload.subarray(start, (start += size)));
}
