/** What a decoder holds of one tile of looks, as `cags_common.tiles.state`. */
import { DecodeError } from "../bytes/errors.ts";
import { decodeCodes, unpacked, withLayer } from "./contexts.ts";
import type { Dequantiser } from "./dequantise.ts";
import type { LodLayer } from "./manifest.ts";
import { type PackedCodes, unpackInto } from "./packing.ts";
import type { Splats } from "./splats.ts";
import { POSITION, PositionLayers } from "./positions.ts";
import { type BaseTile, decodeLayer } from "./tiles.ts";

/** Units of motion by splat: metres, and of a quaternion's imaginary part. */
export interface Steps {
  readonly moves: Float32Array;
  readonly turns: Float32Array;
}

/** One tile: its base, and enhancement layers that may come in any order. */
export class LooksTile {
  readonly kind = "looks";
  /** Units of the splats' motion; undefined in bundles without any. */
  readonly steps: Steps | undefined;
  private readonly base: BaseTile;
  private readonly dequantiser: Dequantiser;
  private readonly order: readonly LodLayer[];
  private codes: Uint32Array | undefined;
  private fresh: Map<string, PackedCodes[]>;
  private depth: Map<string, number>;
  /** Attribute -> codes [n] of the depth there is, while a further layer is coded by them. */
  private prefixes: Map<string, Uint8Array>;
  private waiting: Map<string, Uint8Array>;
  private positions: PositionLayers;

  /** `tables` are units of motion by the base code of scale. */
  constructor(base: BaseTile, dequantiser: Dequantiser, order: readonly LodLayer[], tables: Steps | undefined) {
    this.base = base;
    this.dequantiser = dequantiser;
    this.order = order;
    this.fresh = new Map([...base.layers].map(([name, layer]) => [name, [layer]]));
    this.depth = new Map([...dequantiser.books.keys()].map((name) => [name, 0]));
    this.prefixes = new Map();
    this.waiting = new Map();
    this.positions = new PositionLayers(base.grid.layers);
    this.steps = tables && stepsOf(base, tables);
  }

  get length(): number {
    return this.base.ids.length;
  }

  /** Ids [n], ascending. */
  get ids(): Int32Array {
    return this.base.ids;
  }

  /** Positions [n, 3] as LoD 0 tells them, by which motion is told; {@link dequantise} gives those of all levels. */
  get means(): Float32Array {
    return this.base.means;
  }

  /** Highest LoD up to which everything has come. */
  get lod(): number {
    const depth = (name: string): number => (name === POSITION ? this.positions.depth : this.depth.get(name)!);
    const missing = this.order.findIndex((item) => depth(item.attribute) < item.layer);
    return missing < 0 ? this.order.length : missing;
  }

  /** Take LoD `lod` >= 1; whether a depth rose. Raises {@link DecodeError}. */
  addLayer(lod: number, payload: Uint8Array): boolean {
    const item = this.order[lod - 1];
    if (!item) throw new DecodeError(`tile: LoD ${lod} is outside 1 to ${this.order.length}`);
    if (item.attribute === POSITION) return this.positions.add(item.layer, payload, this.length);
    if (item.layer <= this.depth.get(item.attribute)!) return false;
    this.dequantiser.books.get(item.attribute)!.bitsOf(item.layer); // which refuses one before its codebook
    this.waiting.set(`${item.attribute}/${item.layer}`, payload);
    return this.absorb(item.attribute);
  }

  /** Another state of what has come; what is added to one of the two does not change the other. */
  fork(): LooksTile {
    const other = Object.create(LooksTile.prototype) as LooksTile;
    Object.assign(other, this);
    other.fresh = new Map([...this.fresh].map(([name, parts]) => [name, [...parts]]));
    other.depth = new Map(this.depth);
    other.prefixes = new Map(this.prefixes);
    other.waiting = new Map(this.waiting);
    other.positions = this.positions.fork();
    return other;
  }

  /** Another state, of LoDs 0 .. `lods` - 1 alone, all of which have come. */
  reduced(lods: number): LooksTile {
    const other = this.fork();
    other.waiting.clear();
    const kept = this.order.slice(0, Math.max(lods - 1, 0));
    const depthOf = (name: string): number => Math.max(0, ...kept.filter((i) => i.attribute === name).map((i) => i.layer));
    other.positions.keep(depthOf(POSITION));
    const codes = this.codes?.slice();
    let row = 0;
    for (const [name, held] of this.depth) {
      const book = this.dequantiser.books.get(name)!;
      const depth = depthOf(name);
      const merged = held + 1 - this.fresh.get(name)!.length; // layers that the codes hold
      other.fresh.set(name, this.fresh.get(name)!.slice(0, Math.max(depth + 1 - merged, 0)));
      other.depth.set(name, depth);
      const prefix = this.prefixes.get(name);
      const lost = book.layerBits.slice(depth + 1, held + 1).reduce((a, b) => a + b, 0);
      if (prefix) other.prefixes.set(name, prefix.map((code) => code >> lost));
      const shift = book.layerBits.slice(depth + 1, merged).reduce((a, b) => a + b, 0);
      if (codes && shift) {
        const part = codes.subarray(row * this.length, (row + 1) * this.length);
        part.forEach((code, i) => (part[i] = code >>> shift));
      }
      row++;
    }
    other.codes = codes;
    return other;
  }

  /** The tile's splats [n] at the depths there are. */
  dequantise(): Splats {
    const fresh = [...this.fresh].map(([name, parts]) => ({ first: this.depth.get(name)! + 1 - parts.length, parts }));
    const means = this.positions.of(this.base, this.dequantiser);
    const { splats, codes } = this.dequantiser.run(means, this.codes, fresh);
    this.codes = codes;
    this.fresh = new Map([...this.fresh.keys()].map((name) => [name, []]));
    return splats;
  }

  private absorb(attribute: string): boolean {
    const before = this.depth.get(attribute)!;
    for (let at = before; ; at++) {
      const key = `${attribute}/${at + 1}`;
      const payload = this.waiting.get(key);
      if (!payload) return at > before;
      this.waiting.delete(key);
      this.fresh.get(attribute)!.push(this.decoded(attribute, at + 1, payload));
      this.depth.set(attribute, at + 1);
    }
  }

  /** Codes of the next `layer` of an attribute. Raises {@link DecodeError}. */
  private decoded(attribute: string, layer: number, payload: Uint8Array): PackedCodes {
    const book = this.dequantiser.books.get(attribute)!;
    const [bits, model] = [book.layerBits[layer]!, book.models[layer]];
    const more = book.models.slice(layer + 1).some(Boolean);
    if (!model && !more) return decodeLayer(payload, this.length, bits);
    const prefixes = this.prefixes.get(attribute) ?? unpacked(this.base.layers.get(attribute)!, this.length);
    let codes: Uint8Array;
    let packed: PackedCodes;
    if (model) {
      ({ codes, packed } = decodeCodes(this.dequantiser.kernels, payload, model, prefixes, this.base.near()));
    } else {
      packed = decodeLayer(payload, this.length, bits);
      codes = unpacked(packed, this.length);
    }
    if (more) this.prefixes.set(attribute, withLayer(prefixes, codes, bits));
    return packed;
  }
}

function stepsOf(base: BaseTile, tables: Steps): Steps {
  const codes = new Uint32Array(base.ids.length);
  unpackInto(base.layers.get("scale")!, codes);
  const look = (table: Float32Array): Float32Array => Float32Array.from(codes, (code) => table[code]!);
  return { moves: look(tables.moves), turns: look(tables.turns) };
}
