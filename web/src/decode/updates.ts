/** Updates: attributes that changed, of splats that are there; as `cags_common.tiles.updates`. */
import { DecodeError } from "../bytes/errors.ts";
import { unsqueeze } from "../bytes/inflate.ts";
import type { Codebook } from "./codebooks.ts";
import type { LodLayer } from "./manifest.ts";
import { decodeIds, MAX_SPLATS, type PackedCodes, packedBytes, unpackInto } from "./packing.ts";
import { POSITION } from "./positions.ts";
import { alphaLogit, type Column, SH_REST_ATTRIBUTES } from "./splats.ts";
import { decodeLayer, MAX_TILE_SPLATS } from "./tiles.ts";

export const UPDATE_VERSION = 5;
/** Largest number of frames in which an update reaches its value. */
export const LONGEST_RAMP = 16;
const HEAD_BYTES = 20;
const PLAIN: ReadonlyMap<string, Column> = new Map([
  ["scale", "log_scales"], ["opacity", "logit_opacities"], ["alpha", "logit_opacities"], ["sh0", "sh0"],
]);

/** Columns that updates may change. */
export const UPDATE_COLUMNS = ["log_scales", "logit_opacities", "sh0", "sh_rest"] as const;
export type UpdateColumn = (typeof UPDATE_COLUMNS)[number];

/** Those that may reach their value in more than one frame. */
export const RAMP_COLUMNS = ["log_scales", "sh0", "sh_rest"] as const;
export type RampColumn = (typeof RAMP_COLUMNS)[number];

/** Attributes that may; bands of harmonics change together. */
const RAMPED: readonly string[] = ["scale", "sh0", SH_REST_ATTRIBUTES[0]!];

/** New values of one column: ids [m], values [m, ...], and in how many frames [m] each is reached. */
export interface Change {
  readonly ids: Int32Array;
  readonly values: Float32Array;
  readonly frames: Uint8Array;
}
export type UpdateValues = ReadonlyMap<UpdateColumn, Change>;

/** An update as far as it has come; layers may come in any order. */
export class UpdateTile {
  readonly kind = "update";
  readonly ids: Int32Array;
  private readonly books: ReadonlyMap<string, Codebook>;
  private readonly order: readonly LodLayer[];
  /** Attribute -> ids of the splats of which it changed. */
  private readonly changed: Map<string, Int32Array>;
  /** Attribute -> in how many frames each change is made. */
  private readonly frames: Map<string, Uint8Array>;
  private codes: Map<string, Uint32Array>;
  private depth: Map<string, number>;
  private waiting = new Map<string, PackedCodes>();

  /** Decode LoD 0. Raises {@link DecodeError}. */
  constructor(payload: Uint8Array, books: ReadonlyMap<string, Codebook>, order: readonly LodLayer[]) {
    this.books = books;
    this.order = order;
    const { ids, attributes, masks, ramps, codes } = readParts(payload);
    if (attributes !== books.size) throw new DecodeError(`update: has ${attributes} attributes, the codebooks ${books.size}`);
    this.ids = ids;
    this.changed = readMasks(masks, ids, books);
    this.frames = readRamps(ramps, this.changed);
    this.codes = readCodes(codes, this.changed, books);
    this.depth = new Map([...books.keys()].map((name) => [name, 1]));
  }

  get length(): number {
    return this.ids.length;
  }

  /** Highest LoD up to which everything has come; what nothing changed of has nothing to come. */
  get lod(): number {
    const missing = this.order.findIndex(
      (item) => this.changes(item.attribute) > 0 && this.depth.get(item.attribute)! <= item.layer,
    );
    return missing < 0 ? this.order.length : missing;
  }

  /** Take LoD `lod` >= 1; whether the values changed. Raises {@link DecodeError}. */
  addLayer(lod: number, payload: Uint8Array): boolean {
    const item = this.order[lod - 1];
    if (!item) throw new DecodeError(`update: LoD ${lod} is outside 1 to ${this.order.length}`);
    const count = this.changes(item.attribute);
    if (!count || item.layer < this.depth.get(item.attribute)!) return false;
    const bits = this.books.get(item.attribute)!.bitsOf(item.layer);
    this.waiting.set(`${item.attribute}/${item.layer}`, decodeLayer(payload, count, bits));
    return this.absorb(item.attribute);
  }

  /** Splats of which an attribute changes; positions never do. */
  private changes(name: string): number {
    return name === POSITION ? 0 : this.codes.get(name)!.length;
  }

  /** Another state of what has come; what is added to one of the two does not change the other. */
  fork(): UpdateTile {
    const other = Object.create(UpdateTile.prototype) as UpdateTile;
    Object.assign(other, this);
    other.codes = new Map(this.codes);
    other.depth = new Map(this.depth);
    other.waiting = new Map(this.waiting);
    return other;
  }

  /** Another state, of LoDs 0 .. `lods` - 1 alone, all of which have come. */
  reduced(lods: number): UpdateTile {
    const other = this.fork();
    other.waiting.clear();
    for (const [name, held] of this.depth) {
      const kept = this.order.slice(0, Math.max(lods - 1, 0)).filter((item) => item.attribute === name);
      const depth = Math.min(1 + Math.max(0, ...kept.map((item) => item.layer)), held);
      const shift = this.books.get(name)!.layerBits.slice(depth, held).reduce((a, b) => a + b, 0);
      other.depth.set(name, depth);
      other.codes.set(name, this.codes.get(name)!.map((code) => code >>> shift));
    }
    return other;
  }

  /** What changes, at the depths there are. */
  values(): UpdateValues {
    const out = new Map<UpdateColumn, Change>();
    for (const [name, book] of this.books) {
      const column = PLAIN.get(name) as UpdateColumn | undefined;
      const codes = this.codes.get(name)!;
      if (!column || !codes.length) continue;
      let values = book.lookup(codes, this.depth.get(name)!);
      if (name === "alpha") values = values.map(alphaLogit);
      out.set(column, { ids: this.changed.get(name)!, values, frames: this.frames.get(name)! });
    }
    const bands = SH_REST_ATTRIBUTES.filter((name) => this.books.has(name));
    if (bands.length && this.codes.get(bands[0]!)!.length) out.set("sh_rest", this.harmonics(bands));
    return out;
  }

  private harmonics(bands: readonly string[]): Change {
    const parts = bands.map((name) => this.books.get(name)!.lookup(this.codes.get(name)!, this.depth.get(name)!));
    const dims = bands.map((name) => this.books.get(name)!.dim);
    const width = dims.reduce((a, b) => a + b, 0);
    const count = parts[0]!.length / dims[0]!;
    const values = new Float32Array(count * width);
    let offset = 0;
    parts.forEach((part, band) => {
      const dim = dims[band]!;
      for (let i = 0; i < count; i++) values.set(part.subarray(i * dim, (i + 1) * dim), i * width + offset);
      offset += dim;
    });
    return { ids: this.changed.get(bands[0]!)!, values, frames: this.frames.get(bands[0]!)! };
  }

  private absorb(name: string): boolean {
    const before = this.depth.get(name)!;
    for (let at = before; ; at++) {
      const key = `${name}/${at}`;
      const part = this.waiting.get(key);
      if (!part) {
        this.depth.set(name, at);
        return at > before;
      }
      this.waiting.delete(key);
      const codes = this.codes.get(name)!.slice();
      unpackInto(part, codes);
      this.codes.set(name, codes);
    }
  }
}

interface Parts {
  readonly ids: Int32Array;
  readonly attributes: number;
  readonly masks: Uint8Array;
  readonly ramps: Uint8Array;
  readonly codes: Uint8Array;
}

function readParts(payload: Uint8Array): Parts {
  if (payload.length < HEAD_BYTES) throw new DecodeError(`update: ${payload.length} bytes are too few`);
  const v = new DataView(payload.buffer, payload.byteOffset, HEAD_BYTES);
  const [version, attributes, splats] = [v.getUint8(0), v.getUint8(1), v.getUint32(4, true)];
  const sizes = [8, 12, 16].map((at) => v.getUint32(at, true));
  const [idBytes, maskBytes, rampBytes] = sizes as [number, number, number];
  if (version !== UPDATE_VERSION || splats > MAX_TILE_SPLATS || idBytes + maskBytes + rampBytes > payload.length - HEAD_BYTES) {
    const told = `[${sizes.join(", ")}] bytes of ids, masks and ramps`;
    throw new DecodeError(`update: version ${version}, ${splats} splats, ${told}; beyond bounds`);
  }
  let at = HEAD_BYTES;
  const [idList, masks, ramps] = [idBytes, maskBytes, rampBytes].map((size) => payload.subarray(at, (at += size)));
  const ids = decodeIds(idList!, "update's ids", MAX_SPLATS, splats);
  return { ids, attributes, masks: masks!, ramps: ramps!, codes: payload.subarray(at) };
}

function readMasks(data: Uint8Array, ids: Int32Array, books: ReadonlyMap<string, Codebook>): Map<string, Int32Array> {
  const row = (ids.length + 7) >> 3;
  const bits = unsqueeze(data, row * books.size, "update: masks");
  const names = [...books.keys()];
  const out = new Map(names.map((name, i) => {
    const mask = bits.subarray(i * row, (i + 1) * row);
    return [name, ids.filter((_, k) => (mask[k >> 3]! >> (k & 7)) & 1)];
  }));
  const bands = names.filter((name) => (SH_REST_ATTRIBUTES as readonly string[]).includes(name)).map((name) => out.get(name)!);
  if (bands.some((band) => band.length !== bands[0]!.length || band.some((id, i) => id !== bands[0]![i]))) {
    throw new DecodeError("update: bands of harmonics change for different splats");
  }
  return out;
}

function readCodes(
  data: Uint8Array, changed: ReadonlyMap<string, Int32Array>, books: ReadonlyMap<string, Codebook>,
): Map<string, Uint32Array> {
  const list = [...books.values()];
  const sizes = list.map((book) => packedBytes(changed.get(book.attribute)!.length, book.layerBits[0]!));
  const packed = unsqueeze(data, sizes.reduce((a, b) => a + b, 0), "update: base codes");
  let at = 0;
  return new Map(list.map((book, i) => {
    const codes = new Uint32Array(changed.get(book.attribute)!.length);
    unpackInto({ data: packed.subarray(at, (at += sizes[i]!)), bits: book.layerBits[0]! }, codes);
    return [book.attribute, codes];
  }));
}

function readRamps(data: Uint8Array, changed: ReadonlyMap<string, Int32Array>): Map<string, Uint8Array> {
  const out = new Map([...changed].map(([name, ids]) => [name, new Uint8Array(ids.length).fill(1)]));
  if (!data.length) return out;
  const ramped = [...out].filter(([name]) => RAMPED.includes(name));
  const told = unsqueeze(data, ramped.reduce((sum, [, frames]) => sum + frames.length, 0), "update: ramps");
  const most = told.reduce((a, b) => Math.max(a, b), 0);
  if (most >= LONGEST_RAMP) throw new DecodeError(`update: a ramp of ${most + 1} frames; ${LONGEST_RAMP} are the most`);
  let at = 0;
  for (const [name, frames] of ramped) out.set(name, told.subarray(at, (at += frames.length)).map((count) => count + 1));
  return out;
}
