/** The structs that host and shaders share, packed as WGSL lays them out; `cags_gpu/layout.py` packs the same bytes. */

import type { Camera, Intrinsics } from "../seam.ts";
import { rotationMatrix } from "./camera.ts";

export const TILE_PX = 16;
/** Side of the cells of a veto. */
export const VETO_CELL_PX = 16;
/** Where colours end that no display shows. */
const BRIGHTEST = 3e38;
/** Focal lengths and coordinates up to it have exact centres. */
const FIXED_RANGE_PX = 65536;
const JACOBIAN_MARGIN = 1.3;

/** A pixel is given up when it transmits no more. */
export const STOP = { fast: 1 / 255, balanced: 1e-4, exact: 1e-6 } as const;
export type Exactness = keyof typeof STOP;

/** How a splat's projected covariance is widened, squared pixels; see `cags_common.raster.base.Footprint`. */
export interface Footprint {
  readonly dilationPx2: number;
  readonly filterPx2: number;
}

const DILATION_PX2 = 0.3;
const BOX_VARIANCE_PX2 = 1 / 12;
export const CLASSIC: Footprint = { dilationPx2: DILATION_PX2, filterPx2: 0 };

/** The client's picture as a reference of other resolution sees it. */
export function footprintOf(client: Intrinsics, reference: Intrinsics): Footprint {
  const scaleSquared = (client.fxPx / reference.fxPx) * (client.fyPx / reference.fyPx);
  return scaleSquared <= 1
    ? CLASSIC
    : { dilationPx2: DILATION_PX2 / scaleSquared, filterPx2: BOX_VARIANCE_PX2 };
}

/** The footprint of a picture of half the pixels a side that is brought up again. */
export function atHalfResolution(full: Footprint): Footprint {
  return { dilationPx2: full.dilationPx2 / 4, filterPx2: full.filterPx2 / 4 + BOX_VARIANCE_PX2 / 2 };
}

export interface DrawOptions {
  readonly footprint: Footprint;
  readonly exactness: Exactness;
  /** Pixels of less opacity have no depth. */
  readonly voidAlpha: number;
  readonly maxShDegree: number;
  /** Colours above 1 are cut, as a display does. */
  readonly displayed: boolean;
}

type Kind = "f" | "I";
type Fields = Readonly<Record<string, readonly [offset: number, kind: Kind, count: number]>>;

/** A WGSL struct of 4-byte scalars. */
export class Layout {
  readonly fields: Fields;
  readonly size: number;

  constructor(fields: Fields, size: number) {
    this.fields = fields;
    this.size = size;
  }

  /** The struct's bytes; fields that are not named are zero. Throws for names that are not there. */
  pack(values: Readonly<Record<string, number | readonly number[]>>): ArrayBuffer {
    const out = new DataView(new ArrayBuffer(this.size));
    for (const [name, value] of Object.entries(values)) {
      const field = this.fields[name];
      if (!field) throw new RangeError(`there is no field ${name}`);
      const [offset, kind, count] = field;
      const numbers = typeof value === "number" ? [value] : value;
      if (numbers.length > count) throw new RangeError(`${name} holds ${count} numbers, not ${numbers.length}`);
      numbers.forEach((number, i) => {
        if (kind === "f") out.setFloat32(offset + 4 * i, number, true);
        else out.setUint32(offset + 4 * i, number, true);
      });
    }
    return out.buffer;
  }
}

export const VIEW = new Layout(
  {
    row_x: [0, "f", 4],
    row_y: [16, "f", 4],
    row_z: [32, "f", 4],
    position: [48, "f", 4],
    position_rest: [64, "f", 4],
    focal: [80, "f", 2],
    principal: [88, "f", 2],
    limit: [96, "f", 2],
    size: [104, "I", 2],
    tiles: [112, "I", 2],
    near: [120, "f", 1],
    dilation: [124, "f", 1],
    variance: [128, "f", 1],
    void_alpha: [132, "f", 1],
    stop: [136, "f", 1],
    brightest: [140, "f", 1],
    count: [144, "I", 1],
    sh_count: [148, "I", 1],
    sh_used: [152, "I", 1],
    capacity: [156, "I", 1],
    splats: [160, "I", 1],
    base: [164, "I", 1],
    layers: [168, "I", 1],
    row_x_x: [176, "I", 4],
    row_x_y: [192, "I", 4],
    row_x_z: [208, "I", 4],
    row_y_x: [224, "I", 4],
    row_y_y: [240, "I", 4],
    row_y_z: [256, "I", 4],
    row_z_x: [272, "I", 4],
    row_z_y: [288, "I", 4],
    row_z_z: [304, "I", 4],
    from_x: [320, "I", 4],
    from_y: [336, "I", 4],
    from_z: [352, "I", 4],
    focal_x: [368, "I", 4],
    focal_y: [384, "I", 4],
    principal_xy: [400, "I", 4],
  },
  416,
);
export const CHUNK = new Layout({ first: [0, "I", 1], count: [4, "I", 1] }, 16);
export const UPDATE = new Layout({ rows: [0, "I", 1], sh_words: [4, "I", 1], width: [8, "I", 1] }, 16);
export const SORT = new Layout({ shift: [0, "I", 1], count: [4, "I", 1], blocks: [8, "I", 1], counted: [12, "I", 1] }, 16);
export const COUNT = new Layout({ count: [0, "I", 1] }, 16);
export const CORRECTION = new Layout(
  {
    m0: [0, "f", 4],
    m1: [16, "f", 4],
    m2: [32, "f", 4],
    size: [48, "I", 2],
    reference: [56, "I", 2],
    cell: [64, "f", 2],
    stride: [72, "I", 1],
    tolerance: [76, "f", 1],
    slope_cells: [80, "f", 1],
    border: [84, "f", 1],
    knee: [88, "f", 1],
    hole_alpha: [92, "f", 1],
    grid: [96, "I", 2],
    veto_cell: [108, "I", 1],
  },
  112,
);

export const COMPARE = new Layout({ size: [0, "I", 2], error: [8, "f", 1] }, 16);
export const CHANGED = new Layout(
  { size: [0, "I", 2], grid: [8, "I", 2], count: [16, "I", 1], behind: [20, "f", 1], stale: [24, "f", 1] },
  32,
);

/** Coefficients beyond the base colour, a channel, of each degree. */
export const SH_REST_OF_DEGREE = [0, 3, 8, 15] as const;

export function tilesOf({ widthPx, heightPx }: Intrinsics): [number, number] {
  return [Math.ceil(widthPx / TILE_PX), Math.ceil(heightPx / TILE_PX)];
}

/** The `View` of a camera over a scene of `count` splats with `shCount` harmonics a channel. */
export function viewBytes(
  camera: Camera,
  options: DrawOptions,
  scene: { count: number; shCount: number; capacity: number },
): ArrayBuffer {
  const { intrinsics: i, pose, near } = camera;
  const toWorld = rotationMatrix(pose.rotation);
  const row = (r: number): number[] => [toWorld[0][r], toWorld[1][r], toWorld[2][r]]; // world to camera: transposed
  const rows = [row(0), row(1), row(2)];
  const leading = pose.position.map(Math.fround);
  const axes = ["x", "y", "z"] as const;
  const limbsOf: Record<string, number[]> = {};
  axes.forEach((a, m) => {
    axes.forEach((b, n) => (limbsOf[`row_${a}_${b}`] = limbs(rows[m][n])));
    limbsOf[`from_${a}`] = mantissa(pose.position[m]);
  });
  return VIEW.pack({
    row_x: rows[0],
    row_y: rows[1],
    row_z: rows[2],
    position: leading,
    position_rest: pose.position.map((part, axis) => part - leading[axis]),
    focal: [i.fxPx, i.fyPx],
    principal: [i.cxPx, i.cyPx],
    limit: [(JACOBIAN_MARGIN * 0.5 * i.widthPx) / i.fxPx, (JACOBIAN_MARGIN * 0.5 * i.heightPx) / i.fyPx],
    size: [i.widthPx, i.heightPx],
    tiles: tilesOf(i),
    near,
    dilation: options.footprint.dilationPx2,
    variance: options.footprint.dilationPx2 + options.footprint.filterPx2,
    void_alpha: options.voidAlpha,
    stop: STOP[options.exactness],
    brightest: options.displayed ? 1 : BRIGHTEST,
    count: scene.count,
    splats: scene.count,
    layers: 1,
    sh_count: scene.shCount,
    sh_used: Math.min(scene.shCount, SH_REST_OF_DEGREE[options.maxShDegree]),
    capacity: scene.capacity,
    ...limbsOf,
    focal_x: limbs(i.fxPx / FIXED_RANGE_PX),
    focal_y: limbs(i.fyPx / FIXED_RANGE_PX),
    principal_xy: [...fixed(i.cxPx), ...fixed(i.cyPx)],
  });
}

/** The nearest whole number, of two the even one. */
function rounded(x: number): number {
  const whole = Math.round(x);
  return whole - x === 0.5 && whole % 2 !== 0 ? whole - 1 : whole;
}

/** A number in [-1, 1] as three limbs of 16 bits of its size x 2^47, and whether it is negative. */
function limbs(part: number): [number, number, number, number] {
  if (Math.abs(part) > 1) return [0, 0, 0, 1];
  const whole = rounded(Math.abs(part) * 2 ** 47);
  const low = whole % 2 ** 32;
  return [Math.floor(whole / 2 ** 32), Math.floor(low / 2 ** 16), low % 2 ** 16, part < 0 ? 1 : 0];
}

/** A coordinate in pixels as two words of its 2^31-fold, two's complement; 0 beyond the range. */
function fixed(part: number): [number, number] {
  const whole = Math.abs(part) < FIXED_RANGE_PX ? rounded(part * 2 ** 31) : 0;
  return [Math.floor(whole / 2 ** 32) >>> 0, ((whole % 2 ** 32) + 2 ** 32) % 2 ** 32];
}

/** A coordinate as the two words of its 53-bit mantissa, its exponent + 2048, and whether it is negative. */
function mantissa(part: number): [number, number, number, number] {
  if (part === 0) return [0, 0, 0, 0];
  const bits = new DataView(new ArrayBuffer(8));
  bits.setFloat64(0, Math.abs(part));
  const high = bits.getUint32(0);
  const exponent = high >>> 20; // denormals are no places of a camera: they count as 0
  if (exponent === 0) return [0, 0, 0, part < 0 ? 1 : 0];
  return [(high & 0xfffff) | 0x100000, bits.getUint32(4), exponent - 1023 + 2048, part < 0 ? 1 : 0];
}
