/** Base layers and enhancement layers of tiles of looks, as `cags_common.tiles.payloads`. */
import { DecodeError } from "../bytes/errors.ts";
import { unsqueeze } from "../bytes/inflate.ts";
import { type Codebook, MAX_LAYER_BITS } from "./codebooks.ts";
import { decodeCodes, nearest } from "./contexts.ts";
import type { Dequantiser } from "./dequantise.ts";
import type { Draco } from "./draco.ts";
import type { Kernels } from "./kernels.ts";
import { decodeIds, MAX_SPLATS, type PackedCodes, packedBytes } from "./packing.ts";
import { MAX_POSITION_LAYERS, meansOf, type PositionGrid } from "./positions.ts";

export const BASE_VERSION = 10;
export const MAX_TILE_SPLATS = 65_536;
const MAX_POSITION_BITS = 22;
const MAX_POSITION = 1e30;
const HEADER_BYTES = 32;
const ID_RANGE = 1;
/** The four high bits of the flags are the number of layers of positions. */
const LAYERS_SHIFT = 4;

/** What LoD 0 of a tile holds. */
export interface BaseTile {
  readonly ids: Int32Array;
  readonly grid: PositionGrid;
  /** Integer coordinates [n, 3], without the bits of the layers of positions. */
  readonly cells: Float32Array;
  /** Positions [n, 3] as LoD 0 tells them. */
  readonly means: Float32Array;
  /** Attribute -> n base codes, in coding order. */
  readonly layers: ReadonlyMap<string, PackedCodes>;
  /** The near ones [n, 2] of each splat, by which codes are coded. */
  readonly near: () => Int32Array;
}

interface Header {
  readonly splats: number;
  readonly firstId: number | undefined;
  readonly idBytes: number;
  readonly dracoBytes: number;
  /** Bits of a coordinate in LoD 0. */
  readonly bits: number;
  readonly grid: PositionGrid;
}

/** Decode LoD 0. Raises {@link DecodeError} for damaged payloads. */
export function decodeBase(payload: Uint8Array, dequantiser: Dequantiser, draco: Draco): BaseTile {
  const { books } = dequantiser;
  const head = readHeader(payload, books.size);
  const ids = readIds(payload, head);
  const first = HEADER_BYTES + head.idBytes;
  const { grid, bits } = head;
  const points = payload.subarray(first, first + head.dracoBytes);
  const cells = head.splats ? draco.points(points, head.splats) : new Float32Array(0);
  const end = 2 ** Math.max(bits, 1);
  if (!cells.every((cell) => cell >= 0 && cell < end)) {
    throw new DecodeError(`tile: a position is outside its grid of ${bits} bits`);
  }
  let found: Int32Array | undefined;
  const near = (): Int32Array => (found ??= nearest(dequantiser.kernels, cells));
  const layers = baseLayers(payload.subarray(first + head.dracoBytes), head.splats, books, near, dequantiser.kernels);
  return { ids, grid, cells, means: cells.length ? meansOf(cells, grid, dequantiser) : cells, layers, near };
}

/** One enhancement layer: `count` codes of `bits` bits. Raises {@link DecodeError}. */
export function decodeLayer(payload: Uint8Array, count: number, bits: number): PackedCodes {
  if (bits < 1 || bits > MAX_LAYER_BITS || count > MAX_TILE_SPLATS) {
    throw new DecodeError(`layer: ${count} codes of ${bits} bits are outside the allowed range`);
  }
  return { data: unsqueeze(payload, packedBytes(count, bits), "layer"), bits };
}

function baseLayers(
  data: Uint8Array, count: number, books: ReadonlyMap<string, Codebook>, near: () => Int32Array, kernels: Kernels,
): Map<string, PackedCodes> {
  const modelled = [...books.values()].filter((book) => book.models[0]);
  let at = 4 * modelled.length;
  const lengths = new DataView(data.buffer, data.byteOffset, data.length);
  const sizes = data.length < at ? [data.length] : modelled.map((_, i) => lengths.getUint32(4 * i, true));
  if (at + sizes.reduce((a, b) => a + b, 0) > data.length) {
    throw new DecodeError(`tile: base codes are cut short after ${data.length} bytes`);
  }
  const layers = new Map<string, PackedCodes>();
  modelled.forEach((book, i) => {
    const part = data.subarray(at, (at += sizes[i]!));
    layers.set(book.attribute, decodeCodes(kernels, part, book.models[0]!, undefined, near()).packed);
  });
  const plain = [...books.values()].filter((book) => !book.models[0]);
  const widths = plain.map((book) => packedBytes(count, book.layerBits[0]!));
  const packed = unsqueeze(data.subarray(at), widths.reduce((a, b) => a + b, 0), "tile: base codes");
  plain.reduce((begin, book, i) => {
    layers.set(book.attribute, { data: packed.subarray(begin, begin + widths[i]!), bits: book.layerBits[0]! });
    return begin + widths[i]!;
  }, 0);
  return new Map([...books.keys()].map((name) => [name, layers.get(name)!]));
}

function readHeader(payload: Uint8Array, attributes: number): Header {
  if (payload.length < HEADER_BYTES) throw new DecodeError(`tile: ${payload.length} bytes are too few for a base layer`);
  const v = new DataView(payload.buffer, payload.byteOffset, HEADER_BYTES);
  const [version, bits, columns] = [v.getUint8(0), v.getUint8(2), v.getUint8(3)];
  const [layers, flags] = [v.getUint8(1) >> LAYERS_SHIFT, v.getUint8(1) & ((1 << LAYERS_SHIFT) - 1)];
  const [splats, idField, dracoBytes] = [v.getUint32(4, true), v.getUint32(8, true), v.getUint32(12, true)];
  const origin = [v.getFloat32(16, true), v.getFloat32(20, true), v.getFloat32(24, true)] as const;
  const step = v.getFloat32(28, true);
  if (version !== BASE_VERSION || flags & ~ID_RANGE) {
    throw new DecodeError(`tile: base layer of version ${version}, flags ${flags}; this program reads ${BASE_VERSION}`);
  }
  const [firstId, idBytes] = flags & ID_RANGE ? [idField, 0] : [undefined, idField];
  const many = splats > MAX_TILE_SPLATS || bits > MAX_POSITION_BITS || layers > Math.min(bits, MAX_POSITION_LAYERS);
  if (many || idBytes + dracoBytes > payload.length - HEADER_BYTES) {
    const claims = `${splats} splats, ${bits} position bits, ${layers} of them layers, ${idBytes} bytes of ids`;
    throw new DecodeError(`tile: claims ${claims}, ${dracoBytes} of positions; beyond bounds`);
  }
  if (firstId !== undefined && firstId > MAX_SPLATS - splats) {
    throw new DecodeError(`tile: first id ${firstId} is beyond ${MAX_SPLATS} splats`);
  }
  if (columns !== attributes) throw new DecodeError(`tile: has ${columns} attributes, the codebooks ${attributes}`);
  const reach = Math.max(...origin.map(Math.abs)) + step * 2 ** bits;
  if (![...origin, step].every(Number.isFinite) || step < 0 || reach > MAX_POSITION) {
    throw new DecodeError(`tile: its position grid is not finite or reaches beyond ${MAX_POSITION}`);
  }
  return { splats, firstId, idBytes, dracoBytes, bits: bits - layers, grid: { origin, step, layers } };
}

function readIds(payload: Uint8Array, head: Header): Int32Array {
  const { firstId, splats } = head;
  if (firstId !== undefined) return Int32Array.from({ length: splats }, (_, i) => firstId + i);
  return decodeIds(payload.subarray(HEADER_BYTES, HEADER_BYTES + head.idBytes), "tile ids", MAX_SPLATS, splats);
}
