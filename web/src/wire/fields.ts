/** Kinds of header fields: how a value is checked, written and read back; as `cags_protocol.wire.fields`. */
import { ProtocolError } from "../bytes/errors.ts";
import type { Intrinsics, Pose } from "../seam.ts";
import { makePose } from "./geometry.ts";
import { Float, type Raw } from "./msgpack.ts";

/** How one field travels. Both directions check, and raise {@link ProtocolError} naming the field and the value. */
export interface Kind<T> {
  pack(value: T, name: string): Raw;
  unpack(raw: Raw, name: string): T;
}

/** The one-line error for a field that does not hold what it must. */
export function refuse(name: string, value: unknown, expected: string): never {
  throw new ProtocolError(`${name} = ${shown(value)} must be ${expected}`);
}

function shown(value: unknown): string {
  const plain = (_: string, part: unknown): unknown =>
    part instanceof Float ? part.value : typeof part === "bigint" ? part.toString() : part instanceof Map ? "{...}" : part;
  const text = JSON.stringify(value, plain) ?? String(value);
  return text.length <= 60 ? text : `${text.slice(0, 57)}...`;
}

/** Whole numbers from `low` to `high`, both of which a number holds exactly. */
export function integer(high: number, low = 0): Kind<number> {
  const check = (value: unknown, name: string): number => {
    const whole = typeof value === "number" && Number.isInteger(value);
    return whole && value >= low && value <= high ? value : refuse(name, value, `an integer in [${low}, ${high}]`);
  };
  return { pack: check, unpack: check };
}

/** Whole numbers from 0 to `high`, beyond what a number holds exactly. */
export function wide(high: bigint): Kind<number | bigint> {
  const check = (value: unknown, name: string): number | bigint => {
    const whole = typeof value === "bigint" || (typeof value === "number" && Number.isInteger(value));
    const inside = whole && (value as number) >= 0 && (value as bigint) <= high;
    return inside ? (value as number | bigint) : refuse(name, value, `an integer in [0, ${high}]`);
  };
  return { pack: check, unpack: check };
}

/** Finite numbers. */
export function real(low: number, high: number): Kind<number> {
  const check = (value: number, name: string): number =>
    value >= low && value <= high ? value : refuse(name, value, `a number in [${low}, ${high}]`);
  return {
    pack: (value, name) => new Float(check(value, name)),
    unpack: (raw, name) => {
      if (raw instanceof Float) return check(raw.value, name);
      if (typeof raw === "number" || typeof raw === "bigint") return check(Number(raw), name);
      return refuse(name, raw, `a number in [${low}, ${high}]`);
    },
  };
}

export const flag: Kind<boolean> = { pack: checkFlag, unpack: checkFlag };

function checkFlag(value: unknown, name: string): boolean {
  return typeof value === "boolean" ? value : refuse(name, value, "true or false");
}

const PRINTABLE = /^(?:[^\p{C}\p{Z}]| )*$/u;
const ENCODER = new TextEncoder();

/** Printable text of at most `maxBytes` in UTF-8; control characters would let a peer forge log lines. */
export function text(maxBytes: number): Kind<string> {
  const check = (value: unknown, name: string): string => {
    const good = typeof value === "string" && PRINTABLE.test(value) && ENCODER.encode(value).length <= maxBytes;
    return good ? value : refuse(name, value, `printable text of at most ${maxBytes} bytes`);
  };
  return { pack: check, unpack: check };
}

/** `value` as a text field may carry it: control characters replaced, cut to `maxBytes`. */
export function printable(value: string, maxBytes: number): string {
  const clean = [...value].map((c) => (PRINTABLE.test(c) ? c : "?")).join("");
  const bytes = ENCODER.encode(clean);
  if (bytes.length <= maxBytes) return clean;
  return new TextDecoder("utf-8").decode(bytes.subarray(0, maxBytes)).replace(/\ufffd+$/u, "");
}

/** One of a few words. */
export function choice<W extends string>(...words: W[]): Kind<W> {
  const check = (value: unknown, name: string): W =>
    words.includes(value as W) ? (value as W) : refuse(name, value, `one of ${words.join(", ")}`);
  return { pack: check, unpack: check };
}

/** At most `most` values of one kind. */
export function listOf<T>(kind: Kind<T>, most: number): Kind<readonly T[]> {
  return {
    pack: (value, name) => {
      if (!Array.isArray(value) || value.length > most) refuse(name, value, `a list of at most ${most}`);
      return value.map((item) => kind.pack(item, name));
    },
    unpack: (raw, name) => {
      if (!Array.isArray(raw) || raw.length > most) refuse(name, raw, `a list of at most ${most}`);
      return (raw as Raw[]).map((item) => kind.unpack(item, name));
    },
  };
}

type Kinds<T> = { readonly [K in keyof T]-?: Kind<T[K]> };

/** Several values as the list of them, in the order of `kinds`; what follows the known ones is ignored. `check` raises
 * `RangeError` for values that do not go together. */
export function record<T extends object>(kinds: Kinds<T>, check: (value: T) => void = () => {}): Kind<T> {
  const entries = Object.entries(kinds) as [keyof T & string, Kind<unknown>][];
  return {
    pack: (value, name) => entries.map(([key, kind]) => kind.pack(value[key], `${name}.${key}`)),
    unpack: (raw, name) => {
      if (!Array.isArray(raw) || raw.length < entries.length) return refuse(name, raw, `a list of at least ${entries.length}`);
      const out = Object.fromEntries(entries.map(([key, kind], i) => [key, kind.unpack(raw[i]!, `${name}.${key}`)])) as T;
      try {
        check(out);
      } catch (error) {
        throw new ProtocolError(`${name}: ${(error as Error).message}`);
      }
      return out;
    },
  };
}

const FINITE = real(-1e9, 1e9);
const UNIT = real(-1.001, 1.001);

/** A pose as seven numbers: position, quaternion `wxyz` of unit length (to 1e-3). */
export const pose: Kind<Pose> = {
  pack: (value, name) => [...value.position.map((c) => FINITE.pack(c, name)), ...value.rotation.map((c) => new Float(c))],
  unpack: (raw, name) => {
    if (!Array.isArray(raw) || raw.length !== 7) return refuse(name, raw, "seven numbers");
    const [x, y, z] = raw.slice(0, 3).map((c) => FINITE.unpack(c, name)) as [number, number, number];
    const [w, i, j, k] = raw.slice(3).map((c) => UNIT.unpack(c, name)) as [number, number, number, number];
    if (Math.abs(Math.sqrt(w * w + i * i + j * j + k * k) - 1) > 1e-3) refuse(name, raw, "a position and a unit quaternion");
    return makePose([x, y, z], [w, i, j, k]);
  },
};

const SIDE = integer(16384, 1);
const FOCAL = real(1e-3, 1e6);
const CENTRE = real(-1e6, 1e6);

export const intrinsics: Kind<Intrinsics> = record<Intrinsics>({
  widthPx: SIDE, heightPx: SIDE, fxPx: FOCAL, fyPx: FOCAL, cxPx: CENTRE, cyPx: CENTRE,
});
