/** The codec and motion kernels, compiled to WebAssembly from the sources of the native library. */

/** A kernel refused what it was given; the number is its status (`cags_kernels.h`, `cags_motion.h`). */
export class KernelError extends Error {
  readonly status: number;
  constructor(call: string, status: number) {
    super(`${call}: status ${status}`);
    this.status = status;
  }
}

interface Exports {
  readonly memory: WebAssembly.Memory;
  _initialize(): void;
  cags_web_allocate(bytes: number): number;
  cags_web_free(at: number): void;
  cags_web_pack(splats: number, count: number, rows: number, all: number, out: number): void;
  cags_codec_dequantise(tile: number, attributes: number, targets: number): number;
  cags_codec_positions(
    cells: number, cellsLength: bigint, origin: number, step: number, means: number, meansLength: bigint,
  ): number;
  cags_codec_nearest(cells: number, cellsLength: bigint, nearest: number, nearestLength: bigint): number;
  cags_codec_decode(
    model: number, data: number, bytes: bigint, lanes: bigint, codes: number, codesLength: bigint, packed: number,
    packedLength: bigint,
  ): number;
  cags_symbols_decoder_bytes(): bigint;
  cags_symbols_open(data: number, bytes: bigint, decoder: number, decoderBytes: bigint): number;
  cags_symbols_take(decoder: number, tables: number, tablesLength: bigint, symbols: number, symbolsLength: bigint): number;
  cags_symbols_finish(decoder: number): number;
  cags_motion_neighbours(
    positions: number, positionsLength: bigint, units: number, unitsLength: bigint, neighbours: number, neighboursLength: bigint,
    fits: number, fitsLength: bigint,
  ): number;
  cags_motion_decode_tree(
    tree: number, decoder: number, escapes: number, escapesLength: bigint, escape: number, told: number, toldLength: bigint,
    samples: number, samplesLength: bigint,
  ): number;
  cags_motion_rows(tiles: number, count: number, arrays: number, threads: number): number;
}

export type Numbers = Float32Array | Float64Array | Int32Array | Uint32Array | Uint16Array | Uint8Array;

/** One instance of the module. Everything that is not named a block is freed when the call ends. */
export class Kernels {
  readonly calls: Exports;
  private readonly memory: WebAssembly.Memory;

  private constructor(exports: Exports) {
    this.calls = exports;
    this.memory = exports.memory;
    exports._initialize();
  }

  /** Compile and start the module. */
  static async load(source: BufferSource | Response | Promise<Response>): Promise<Kernels> {
    const nothing = (): number => 0;
    const imports = { wasi_snapshot_preview1: { fd_close: nothing, fd_seek: nothing, fd_write: nothing } };
    const buffer = source instanceof ArrayBuffer || ArrayBuffer.isView(source);
    const { instance } = buffer
      ? await WebAssembly.instantiate(source as BufferSource, imports)
      : await WebAssembly.instantiateStreaming(source as Promise<Response>, imports);
    return new Kernels(instance.exports as unknown as Exports);
  }

  /** Memory that stays until {@link free}. Raises `RangeError` where there is none left. */
  allocate(bytes: number): number {
    const at = this.calls.cags_web_allocate(Math.max(bytes, 16));
    if (!at) throw new RangeError(`no memory for ${bytes} bytes`);
    return at;
  }

  free(at: number): void {
    this.calls.cags_web_free(at);
  }

  /** Views of memory; they end with the next allocation. */
  f32(at: number, length: number): Float32Array<ArrayBuffer> {
    return new Float32Array(this.memory.buffer as ArrayBuffer, at, length);
  }

  f64(at: number, length: number): Float64Array<ArrayBuffer> {
    return new Float64Array(this.memory.buffer as ArrayBuffer, at, length);
  }

  i32(at: number, length: number): Int32Array<ArrayBuffer> {
    return new Int32Array(this.memory.buffer as ArrayBuffer, at, length);
  }

  u32(at: number, length: number): Uint32Array<ArrayBuffer> {
    return new Uint32Array(this.memory.buffer as ArrayBuffer, at, length);
  }

  u8(at: number, length: number): Uint8Array<ArrayBuffer> {
    return new Uint8Array(this.memory.buffer as ArrayBuffer, at, length);
  }

  view(at: number, length: number): DataView {
    return new DataView(this.memory.buffer, at, length);
  }

  /** Write lengths of arrays, as structures have them, from `at` on. */
  writeLengths(at: number, lengths: readonly number[]): void {
    new BigInt64Array(this.memory.buffer, at, lengths.length).set(lengths.map(BigInt));
  }

  /** Copy `array` to memory at `at`. */
  write(at: number, array: Numbers): void {
    this.u8(at, array.byteLength).set(new Uint8Array(array.buffer, array.byteOffset, array.byteLength));
  }

  /** A block that holds a copy of `array`. */
  block(array: Numbers): number {
    const at = this.allocate(array.byteLength);
    this.write(at, array);
    return at;
  }

  /** Run `work` with memory that is freed after it. */
  scoped<T>(work: (scope: Scope) => T): T {
    const scope = new Scope(this);
    try {
      return work(scope);
    } finally {
      scope.end();
    }
  }
}

/** Memory of one call. */
export class Scope {
  private readonly kernels: Kernels;
  private readonly taken: number[] = [];

  constructor(kernels: Kernels) {
    this.kernels = kernels;
  }

  take(bytes: number): number {
    const at = this.kernels.allocate(bytes);
    this.taken.push(at);
    return at;
  }

  put(array: Numbers): number {
    const at = this.take(array.byteLength);
    this.kernels.write(at, array);
    return at;
  }

  end(): void {
    for (const at of this.taken) this.kernels.free(at);
  }
}

/** Raises {@link KernelError} unless `status` is that of success. */
export function check(call: string, status: number): void {
  if (status) throw new KernelError(call, status);
}
