/** Positions of a tile on its grid, and their layers, as `cags_common.tiles.payloads` and `cags_common.tiles.state`. */
import { DecodeError } from "../bytes/errors.ts";
import { unsqueeze } from "../bytes/inflate.ts";
import type { Dequantiser } from "./dequantise.ts";
import { packedBytes } from "./packing.ts";
import type { BaseTile } from "./tiles.ts";

/** The attribute of a LoD that refines positions; it has no codebook. */
export const POSITION = "position";
/** Bits an axis that layers of positions may add. */
export const MAX_POSITION_LAYERS = 8;

/** The grid that positions are rounded to: `origin + step * integer`, of which the lowest bits are `layers` of their own. */
export interface PositionGrid {
  readonly origin: readonly [number, number, number];
  readonly step: number;
  readonly layers: number;
}

/** Layers of a tile's positions, which may come in any order. */
export class PositionLayers {
  private readonly layers: number;
  private bits = new Map<number, Uint8Array>();

  constructor(layers: number) {
    this.layers = layers;
  }

  /** Layers without a gap; without end where the tile has no more. */
  get depth(): number {
    const come = this.come;
    return come === this.layers ? MAX_POSITION_LAYERS : come;
  }

  private get come(): number {
    let layers = 0;
    while (this.bits.has(layers + 1)) layers++;
    return layers;
  }

  /** Take a `layer` of `count` splats; whether the depth rose. Raises {@link DecodeError}. */
  add(layer: number, payload: Uint8Array, count: number): boolean {
    if (layer > this.layers) {
      if (!payload.length) return false;
      throw new DecodeError(`tile: has layer ${layer} of positions, but its base says ${this.layers}`);
    }
    if (this.bits.has(layer)) return false;
    const before = this.come;
    this.bits.set(layer, unsqueeze(payload, packedBytes(count, 3), "layer"));
    return this.come > before;
  }

  /** Positions [n, 3] of a tile at the depth there is. */
  of(base: BaseTile, dequantiser: Dequantiser): Float32Array {
    const come = this.come;
    if (!come) return base.means;
    return meansOf(base.cells, base.grid, dequantiser, Array.from({ length: come }, (_, i) => this.bits.get(i + 1)!));
  }

  /** Only the first `layers`. */
  keep(layers: number): void {
    this.bits = new Map([...this.bits].filter(([layer]) => layer <= layers));
  }

  /** An independent copy. */
  fork(): PositionLayers {
    const other = new PositionLayers(this.layers);
    other.bits = new Map(this.bits);
    return other;
  }
}

/** Positions [n, 3] of coarse `cells` and the first layers' `bits`, a bit an axis: the middle of all that they may become. */
export function meansOf(
  cells: Float32Array, grid: PositionGrid, dequantiser: Dequantiser, bits: readonly Uint8Array[] = [],
): Float32Array {
  const lacking = 2 ** (grid.layers - bits.length);
  const whole = cells.slice();
  for (const layer of bits) {
    for (let i = 0; i < whole.length; i++) whole[i] = 2 * whole[i]! + ((layer[i >> 3]! >> (i & 7)) & 1);
  }
  for (let i = 0; i < whole.length; i++) whole[i] = whole[i]! * lacking + (lacking - 1) / 2;
  return dequantiser.positions(whole, grid.origin, grid.step);
}
