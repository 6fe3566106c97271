/** Codebooks of Scalable Vector Quantisation, as `cags_common.tiles.svq`: rows that layered codes stand for. */
import { DecodeError } from "../bytes/errors.ts";
import { gunzip } from "../bytes/inflate.ts";
import { canBeModelled, ContextModel, prefixBits } from "./contexts.ts";
import { ATTRIBUTE_DIMS } from "./splats.ts";

const MAGIC = "CAGSCB02";
const MAX_BASE_BITS = 8;
export const MAX_LAYER_BITS = 8;
const MAX_STAGE_BITS = 16;
const MAX_CODEBOOK_BYTES = 16 * 2 ** 20;
const ATTRIBUTES = [...ATTRIBUTE_DIMS.keys()];

/** One attribute's layered codebook: a tree, and optionally a second one that refines its leaves. */
export class Codebook {
  readonly attribute: string;
  readonly dim: number;
  readonly layerBits: readonly number[];
  /** `tables[k]` [rows, dim] holds what codes of k + 1 layers stand for. */
  readonly tables: readonly Float32Array[];
  /** Layers of the first tree. */
  readonly firstStage: number;
  /** [leaves, dim]: the unit of the second tree's rows. */
  readonly spreads: Float32Array | undefined;
  /** Of the first layers: how codes of tiles are coded by context; undefined: they are packed. */
  readonly models: readonly (ContextModel | undefined)[];

  constructor(
    attribute: string, layerBits: number[], tables: Float32Array[], firstStage: number, spreads: Float32Array | undefined,
    models: readonly (ContextModel | undefined)[],
  ) {
    this.attribute = attribute;
    this.dim = ATTRIBUTE_DIMS.get(attribute)!;
    this.layerBits = layerBits;
    this.tables = tables;
    this.firstStage = firstStage;
    this.spreads = spreads;
    this.models = models;
    if (layerBits.some((bits) => bits < 1 || bits > MAX_LAYER_BITS)) outside(attribute, layerBits);
  }

  /** Number of layers above the base. */
  get enhancementLayers(): number {
    return this.layerBits.length - 1;
  }

  /** Bits that `layer` (0 = base) adds to a code. Raises {@link DecodeError} for one that has not come. */
  bitsOf(layer: number): number {
    const bits = this.layerBits[layer];
    if (bits === undefined) {
      throw new DecodeError(`layer ${layer} of '${this.attribute}' came before its codebook, which ends at that`);
    }
    return bits;
  }

  /** Whether the first layers of `other` are those of this book. */
  begins(other: Codebook): boolean {
    const { layerBits, tables } = this;
    const same = (a: ArrayLike<number>, b: ArrayLike<number> | undefined): boolean =>
      a.length === b?.length && Array.prototype.every.call(a, (value: number, i: number) => value === b[i]);
    const none = new Uint16Array();
    const modelled = layerBits.every((_, i) => same(this.models[i]?.frequencies ?? none, other.models[i]?.frequencies ?? none));
    if (!modelled || !layerBits.every((bits, i) => bits === other.layerBits[i])) return false;
    return tables.every((table, i) => same(table, other.tables[i]));
  }

  /** Bits of a code that holds the first `layers` layers. */
  codeBits(layers: number): number {
    return this.layerBits.slice(0, layers).reduce((a, b) => a + b, 0);
  }

  /** Bits of the second tree in a code of `layers` layers. */
  belowBits(layers: number): number {
    const second = this.spreads !== undefined && layers > this.firstStage;
    return second ? this.codeBits(layers) - this.codeBits(this.firstStage) : 0;
  }

  /** Values [n, dim] of codes [n] that hold the first `layers` layers' bits. */
  lookup(codes: Uint32Array, layers: number): Float32Array<ArrayBuffer> {
    const { dim } = this;
    const table = this.tables[layers - 1]!;
    const out = new Float32Array(codes.length * dim);
    const below = this.belowBits(layers);
    if (!below) {
      codes.forEach((code, i) => out.set(table.subarray(code * dim, code * dim + dim), i * dim));
      return out;
    }
    const leaves = this.tables[this.firstStage - 1]!;
    for (let i = 0, to = 0; i < codes.length; i++) {
      const leaf = (codes[i]! >>> below) * dim;
      const row = (codes[i]! & ((1 << below) - 1)) * dim;
      for (let d = 0; d < dim; d++) out[to++] = Math.fround(table[row + d]! * this.spreads![leaf + d]!) + leaves[leaf + d]!;
    }
    return out;
  }
}

function outside(attribute: string, bits: readonly number[]): never {
  throw new DecodeError(`codebook '${attribute}': layers of ${bits} bits are outside the allowed range`);
}

/** The codebooks of a bundle by attribute, in coding order. Raises {@link DecodeError} for anything else. */
export function readCodebooks(data: Uint8Array): Map<string, Codebook> {
  const magic = String.fromCharCode(...data.subarray(0, MAGIC.length));
  if (magic !== MAGIC) throw new DecodeError(`codebooks: do not begin with ${MAGIC} (another version?)`);
  const body = new Cursor(gunzip(data.subarray(MAGIC.length), MAX_CODEBOOK_BYTES, "codebooks"));
  const count = body.byte();
  if (count > ATTRIBUTES.length) throw new DecodeError(`codebooks: ${count} of them for ${ATTRIBUTES.length} attributes`);
  const books = Array.from({ length: count }, () => readBook(body));
  body.finish();
  const byName = new Map(books.map((book) => [book.attribute, book]));
  if (byName.size !== count) throw new DecodeError("codebooks: an attribute appears twice");
  return new Map(ATTRIBUTES.filter((name) => byName.has(name)).map((name) => [name, byName.get(name)!]));
}

function readBook(body: Cursor): Codebook {
  const [index, tree, above] = [body.byte(), body.byte(), body.byte()];
  const attribute = ATTRIBUTES[index];
  if (attribute === undefined) throw new DecodeError(`codebooks: attribute number ${index} is unknown`);
  const bits = [...body.take(tree + above)];
  const stages = [bits.slice(0, tree), bits.slice(tree)];
  const sums = stages.map((stage) => stage.reduce((a, b) => a + b, 0));
  if (!tree || bits.includes(0) || bits[0]! > MAX_BASE_BITS || Math.max(...sums) > MAX_STAGE_BITS) outside(attribute, bits);
  const tables = stages.flatMap((stage) => readStage(body, stage, attribute));
  const spreads = above ? readSpreads(body, 2 ** sums[0]!, attribute) : undefined;
  return new Codebook(attribute, bits, tables, above ? tree : bits.length, spreads, readModels(body, bits, attribute));
}

function readModels(body: Cursor, layerBits: readonly number[], attribute: string): (ContextModel | undefined)[] {
  const which = body.byte();
  const models: (ContextModel | undefined)[] = [];
  for (let layer = 0; which >> layer; layer++) {
    if (!((which >> layer) & 1)) {
      models.push(undefined);
      continue;
    }
    if (layer >= layerBits.length || !canBeModelled(layerBits, layer)) {
      throw new DecodeError(`codebook '${attribute}': layer ${layer} cannot have such a model`);
    }
    const [bits, below] = [layerBits[layer]!, prefixBits(layerBits, layer)];
    models.push(new ContextModel(bits, below, body.take(ContextModel.size(bits, below))));
  }
  return models;
}

/** Tables of one tree: whole numbers of steps, a power of two for each column, from what the parents hold. */
function readStage(body: Cursor, layerBits: number[], attribute: string): Float32Array[] {
  const dim = ATTRIBUTE_DIMS.get(attribute)!;
  const tables: Float32Array[] = [];
  let parents = new Float32Array(dim);
  for (const bits of layerBits) {
    const count = parents.length << bits;
    const steps = Float64Array.from(body.take(dim), (byte) => 2 ** ((byte << 24) >> 24));
    const [low, high] = [body.take(count), body.take(count)];
    const table = new Float32Array(count);
    for (let i = 0; i < count; i++) {
      const folded = low[i]! | (high[i]! << 8);
      const away = Math.fround(((folded >> 1) ^ -(folded & 1)) * steps[i % dim]!);
      table[i] = parents[(Math.floor(i / dim) >> bits) * dim + (i % dim)]! + away;
    }
    tables.push((parents = finite(table, attribute)));
  }
  return tables;
}

/** Float16 without sign and without the last seven bits of the fraction. */
function readSpreads(body: Cursor, rows: number, attribute: string): Float32Array {
  const bytes = body.take(rows * ATTRIBUTE_DIMS.get(attribute)!);
  return finite(Float32Array.from(bytes, spread), attribute);
}

function spread(byte: number): number {
  const [exponent, fraction] = [byte >> 3, byte & 7];
  if (exponent === 31) return Infinity;
  return exponent ? 2 ** (exponent - 18) * (8 + fraction) : 2 ** -17 * fraction;
}

function finite<A extends Float32Array>(values: A, attribute: string): A {
  if (!values.every(Number.isFinite)) throw new DecodeError(`codebook '${attribute}': holds a value that is not finite`);
  return values;
}

/** Reads bytes in order and never past the end. */
class Cursor {
  private readonly data: Uint8Array;
  private at = 0;

  constructor(data: Uint8Array) {
    this.data = data;
  }

  take(size: number): Uint8Array {
    if (size > this.data.length - this.at) throw new DecodeError(`codebooks: cut short at byte ${this.data.length}`);
    this.at += size;
    return this.data.subarray(this.at - size, this.at);
  }

  byte(): number {
    return this.take(1)[0]!;
  }

  finish(): void {
    if (this.at !== this.data.length) throw new DecodeError(`codebooks: ${this.data.length - this.at} bytes too many`);
  }
}
