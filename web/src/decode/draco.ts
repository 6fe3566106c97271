/** Draco point clouds by the WebAssembly decoder of npm `draco3d`; what a header claims is checked before it is read. */
import createDecoder from "draco3d/draco_decoder_nodejs.js";
import { DecodeError } from "../bytes/errors.ts";

interface DracoModule {
  readonly HEAPF32: Float32Array;
  readonly POSITION: number;
  readonly DT_FLOAT32: number;
  readonly Decoder: new () => DracoDecoder;
  readonly DecoderBuffer: new () => { Init(data: Int8Array, length: number): void };
  readonly PointCloud: new () => { num_points(): number };
  _malloc(bytes: number): number;
  _free(at: number): void;
  destroy(object: unknown): void;
}

interface DracoDecoder {
  DecodeBufferToPointCloud(buffer: unknown, cloud: unknown): { ok(): boolean; error_msg(): string };
  GetAttributeId(cloud: unknown, kind: number): number;
  GetAttribute(cloud: unknown, id: number): { num_components(): number };
  GetAttributeDataArrayForAllPoints(cloud: unknown, attribute: unknown, type: number, bytes: number, at: number): boolean;
}

const HEADER_BYTES = 15; // magic 5, version 2, geometry type, method, flags 2, points 4
const MAGIC = [0x44, 0x52, 0x41, 0x43, 0x4f];

/** A decoder of positions. */
export class Draco {
  private readonly module: DracoModule;
  private readonly decoder: DracoDecoder;

  private constructor(module: DracoModule) {
    this.module = module;
    this.decoder = new module.Decoder();
  }

  /** Start the decoder; `wasmBinary` is the package's `draco_decoder.wasm`. */
  static async load(wasmBinary: ArrayBuffer | Uint8Array): Promise<Draco> {
    return new Draco((await createDecoder({ wasmBinary })) as DracoModule);
  }

  /** Positions [count, 3] in the order of the points. Raises {@link DecodeError}. */
  points(data: Uint8Array, count: number): Float32Array<ArrayBuffer> {
    checkHeader(data, count);
    const m = this.module;
    const buffer = new m.DecoderBuffer();
    const cloud = new m.PointCloud();
    try {
      buffer.Init(new Int8Array(data.buffer, data.byteOffset, data.length), data.length);
      const status = this.decoder.DecodeBufferToPointCloud(buffer, cloud);
      if (!status.ok()) throw new DecodeError(`tile: Draco cannot decode it (${status.error_msg()})`);
      return this.positions(cloud, count);
    } finally {
      m.destroy(cloud);
      m.destroy(buffer);
    }
  }

  private positions(cloud: { num_points(): number }, count: number): Float32Array<ArrayBuffer> {
    const m = this.module;
    const id = this.decoder.GetAttributeId(cloud, m.POSITION);
    const attribute = id < 0 ? undefined : this.decoder.GetAttribute(cloud, id);
    if (cloud.num_points() !== count || attribute?.num_components() !== 3) {
      throw new DecodeError("tile: Draco data holds no positions, or some of another shape");
    }
    const at = m._malloc(12 * count);
    try {
      this.decoder.GetAttributeDataArrayForAllPoints(cloud, attribute, m.DT_FLOAT32, 12 * count, at);
      return new Float32Array(m.HEAPF32.buffer as ArrayBuffer, at, 3 * count).slice();
    } finally {
      m._free(at);
    }
  }
}

function checkHeader(data: Uint8Array, count: number): void {
  if (data.length < HEADER_BYTES) throw new DecodeError("tile: Draco data is cut short");
  const view = new DataView(data.buffer, data.byteOffset, HEADER_BYTES);
  const named = MAGIC.every((byte, i) => data[i] === byte) && data[7] === 0 && view.getUint16(9, true) === 0;
  if (!named || view.getUint32(11, true) !== count) {
    throw new DecodeError(`tile: Draco data is not a point cloud of ${count} points`);
  }
}
