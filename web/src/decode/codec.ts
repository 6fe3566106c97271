/** Opens the tiles of one bundle: payloads to decoders, as `cags_common.bundle.codecs.SvqTileCodec`. */
import { BundleError, DecodeError } from "../bytes/errors.ts";
import { MOTION_VERSION, MotionTile } from "../motion/chunk.ts";
import { type Codebook, readCodebooks } from "./codebooks.ts";
import { Dequantiser } from "./dequantise.ts";
import type { Draco } from "./draco.ts";
import type { Kernels } from "./kernels.ts";
import { LooksTile, type Steps } from "./looks.ts";
import type { LodLayer, Manifest } from "./manifest.ts";
import { MAX_POSITION_LAYERS, POSITION } from "./positions.ts";
import { SH_REST_ATTRIBUTES } from "./splats.ts";
import { decodeBase } from "./tiles.ts";
import { UPDATE_VERSION, UpdateTile } from "./updates.ts";

export type AnyTile = LooksTile | MotionTile | UpdateTile;

/** The codec `svq`. Raises {@link BundleError} for another, {@link DecodeError} for codebooks that cannot be read. */
export class TileCodec {
  readonly kernels: Kernels;
  private readonly draco: Draco;
  private readonly order: readonly LodLayer[];
  private readonly dequantiser: Dequantiser;
  private readonly steps: Steps | undefined;

  constructor(manifest: Manifest, codebooks: Uint8Array, kernels: Kernels, draco: Draco) {
    if (manifest.codec !== "svq") throw new BundleError(`codec '${manifest.codec}' is unknown; this viewer reads svq`);
    const books = readCodebooks(codebooks);
    checkOrder(manifest.lodOrder, layersOf(books, manifest.lodOrder));
    const degree = SH_REST_ATTRIBUTES.filter((name) => books.has(name)).length;
    if (degree !== manifest.shDegree) {
      throw new BundleError(`manifest: sh_degree is ${manifest.shDegree}, but the codebooks are of degree ${degree}`);
    }
    this.kernels = kernels;
    this.draco = draco;
    this.order = manifest.lodOrder;
    this.dequantiser = new Dequantiser(kernels, books);
    this.steps = stepTables(manifest, books.get("scale")!.layerBits[0]!);
  }

  /** Add the layers above the base; open tiles take further levels from now on. Raises {@link DecodeError}. */
  extend(codebooks: Uint8Array): void {
    const books = readCodebooks(codebooks);
    checkOrder(this.order, layersOf(books));
    this.dequantiser.extend(books);
  }

  /** Decode LoD 0 of a tile of any kind; its first byte tells them apart. `looks` are those that a tile of motion moves.
   * Raises {@link DecodeError}. */
  open(payload: Uint8Array, looks?: LooksTile): AnyTile {
    if (payload[0] === UPDATE_VERSION) return new UpdateTile(payload, this.dequantiser.books, this.order);
    if (payload[0] === MOTION_VERSION) return this.openMotion(payload, looks);
    return new LooksTile(decodeBase(payload, this.dequantiser, this.draco), this.dequantiser, this.order, this.steps);
  }

  /** Decode level 0 of motion of `looks`. Raises {@link DecodeError}. */
  openMotion(payload: Uint8Array, looks: LooksTile | undefined): MotionTile {
    if (!looks?.steps) throw new DecodeError("motion: cannot be read without the looks that it moves");
    return new MotionTile(payload, { positions: looks.means, ...looks.steps }, this.kernels);
  }

  /** Free what the kernels keep. */
  dispose(): void {
    this.dequantiser.dispose();
  }
}

/** Enhancement layers by attribute; where there are none, those of the `order`: they are yet to come. */
function layersOf(books: ReadonlyMap<string, Codebook>, order: readonly LodLayer[] = []): Map<string, number> {
  const layers = new Map([...books].map(([name, book]) => [name, book.enhancementLayers]));
  if ([...layers.values()].some((count) => count > 0)) return layers;
  for (const { attribute, layer } of order) if (layers.has(attribute)) layers.set(attribute, layer);
  return layers;
}

function checkOrder(order: readonly LodLayer[], layers: ReadonlyMap<string, number>): void {
  const seen = new Map([...layers.keys(), POSITION].map((name) => [name, 0]));
  for (const [i, item] of order.entries()) {
    const before = seen.get(item.attribute);
    if (before === undefined) throw new BundleError(`LoD ${i + 1} refines attribute '${item.attribute}', which has no codebook`);
    if (item.layer !== before + 1) {
      throw new BundleError(`LoD ${i + 1} is layer ${item.layer} of '${item.attribute}', expected layer ${before + 1}`);
    }
    seen.set(item.attribute, item.layer);
  }
  const positions = seen.get(POSITION)!;
  if (positions > MAX_POSITION_LAYERS) {
    throw new BundleError(`LoD order has ${positions} layers of positions; at most ${MAX_POSITION_LAYERS} exist`);
  }
  for (const [name, count] of layers) {
    if (seen.get(name) !== count) throw new BundleError(`LoD order has ${seen.get(name)} of the ${count} layers of '${name}'`);
  }
}

function stepTables(manifest: Manifest, scaleBits: number): Steps | undefined {
  const { motion } = manifest;
  if (!motion) return undefined;
  if (motion.moves.length !== 1 << scaleBits) {
    throw new BundleError(`manifest: motion has ${motion.moves.length} units, which are not one a base code of scale`);
  }
  return { moves: Float32Array.from(motion.moves), turns: Float32Array.from(motion.turns) };
}

