/** The strict encoding of messages, as `cags_protocol.wire.encoding`: bytes to checked values and back. */
import { crc32 } from "../bytes/crc32.ts";
import { ProtocolError } from "../bytes/errors.ts";
import * as limits from "./limits.ts";
import { type Message, SPECS, type Spec, type Tag } from "./messages.ts";
import { MsgpackError, pack, type Raw, unpack } from "./msgpack.ts";

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
const CRC_MARK = [0xa3, 0x63, 0x72, 0x63, 0xce];

/** The wire form of `message` and its payload. Raises {@link ProtocolError} for values that must not travel. */
export function encode(message: Message, payload: Uint8Array = EMPTY): Uint8Array<ArrayBuffer> {
  const spec = SPECS[message.type];
  const values = message as unknown as Record<string, unknown>;
  if (spec.payload === "opaque") checkPayload(message, payload.length);
  else if (payload.length) throw new ProtocolError(`${message.type} carries no separate payload`);
  else if (spec.payload !== "none") payload = values[spec.payload] as Uint8Array;
  const header = new Map<string, Raw>([["type", message.type]]);
  for (const { name, kind, fallback } of spec.fields) {
    const value = values[name];
    if (fallback === undefined || !isFallback(value, fallback)) header.set(name, kind.pack(value, name));
  }
  header.set("crc", 0xffffffff); // the widest integer form; its value is written below, over these four bytes
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
  if (!CRC_MARK.every((byte, i) => data[end - 9 + i] === byte)) throw new DamagedError("header does not end with its crc");
  const told = new DataView(data.buffer, data.byteOffset + end - 4, 4).getUint32(0);
  if (crc32(payload, crc32(data.subarray(0, end - 4))) !== told) {
    throw new DamagedError("crc does not match: the message was damaged on its way");
  }
  const tag = header.get("type");
  if (typeof tag !== "string" || !Object.hasOwn(SPECS, tag)) {
    throw new ProtocolError(`type = ${String(tag).slice(0, 60)} is not a known message`);
  }
  if (tag === "hello") checkVersion(header);
  const spec = SPECS[tag as Tag];
  const message = build(tag as Tag, spec, header, payload);
  if (spec.payload !== "opaque") return { message, payload: EMPTY };
  checkPayload(message, payload.length);
  return { message, payload };
}

function readHeader(data: Uint8Array): { header: Map<string, Raw>; end: number } {
  try {
    const { value, end } = unpack(data.subarray(0, limits.MAX_HEADER_BYTES), BOUNDS);
    if (!(value instanceof Map)) throw new DamagedError("header is not a map");
    return { header: value, end };
  } catch (error) {
    if (error instanceof MsgpackError) throw new DamagedError(`header is not readable (${error.message})`);
    throw error;
  }
}

function checkVersion(header: Map<string, Raw>): void {
  const version = header.get("version");
  const whole = typeof version === "bigint" || typeof version === "number";
  if (whole && !limits.SUPPORTED_VERSIONS.includes(Number(version))) {
    throw new VersionError(`version = ${version} is not spoken here`);
  }
}

function build(tag: Tag, spec: Spec, header: Map<string, Raw>, payload: Uint8Array): Message {
  const values: Record<string, unknown> = { type: tag };
  for (const { name, kind, fallback } of spec.fields) {
    const raw = header.get(name);
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
    if (count < 1 || message.sizes.length !== count || message.crcs.length !== count) {
      const range = `${message.from_lod}..${message.to_lod}`;
      const got = `${message.sizes.length} and ${message.crcs.length}`;
      throw new ProtocolError(`tile: LoDs ${range} need ${Math.max(count, 1)} sizes and crcs, got ${got}`);
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
