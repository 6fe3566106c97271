/** Packed codes to splats by the codec kernel, as `cags_common.tiles.dequantise`: the same bits. */
import { DecodeError } from "../bytes/errors.ts";
import type { Codebook } from "./codebooks.ts";
import { check, KernelError, type Kernels, type Scope } from "./kernels.ts";
import type { PackedCodes } from "./packing.ts";
import { alphaLogit, SH_REST_ATTRIBUTES, SH_REST_OF_DEGREE, type Splats } from "./splats.ts";

/** The kernel's columns, in its order, and where the values of an attribute go: column and first number of a row. */
const COLUMNS = ["quats", "log_scales", "logit_opacities", "sh0", "sh_rest"] as const;
const PLACES: ReadonlyMap<string, readonly [number, number]> = new Map([
  ["scale", [1, 0]], ["rotation", [0, 1]], ["rotation_real", [0, 0]], ["rotation_imag", [0, 1]], ["opacity", [2, 0]],
  ["alpha", [2, 0]], ["sh0", [3, 0]], ["sh1", [4, 0]], ["sh2", [4, 9]], ["sh3", [4, 24]],
]);
/** Sizes of the kernel's structures, and where the lengths of their arrays begin (`cags_codec.h`, pointers of 4 bytes). */
const [ATTRIBUTE_BYTES, ATTRIBUTE_LENGTHS, TILE_BYTES, TARGETS_BYTES, TARGETS_LENGTHS] = [72, 40, 64, 72, 24];

/** Layers of one attribute that its codes do not hold yet: `parts[i]` is layer `first + i`. */
export interface FreshLayers {
  readonly first: number;
  readonly parts: readonly PackedCodes[];
}

/** Turns codes into splats by one set of codebooks. Raises {@link DecodeError} for a missing attribute. */
export class Dequantiser {
  /** They may hold base layers only, and get the others later ({@link extend}). */
  readonly books: Map<string, Codebook>;
  readonly shDegree: number;
  readonly kernels: Kernels;
  private readonly rodrigues: boolean;
  private readonly logits: boolean;
  private readonly tables = new Map<Float32Array, number>();

  constructor(kernels: Kernels, books: Map<string, Codebook>) {
    checkForms(books);
    this.kernels = kernels;
    this.books = books;
    this.shDegree = SH_REST_ATTRIBUTES.filter((name) => books.has(name)).length;
    this.rodrigues = books.has("rotation");
    this.logits = books.has("alpha");
  }

  /** Add the further layers of `books`. Raises {@link DecodeError} if its first layers are others. */
  extend(books: ReadonlyMap<string, Codebook>): void {
    const known = [...this.books];
    const goesOn = ([name, book]: [string, Codebook]): boolean => books.has(name) && book.begins(books.get(name)!);
    if (books.size !== known.length || !known.every(goesOn)) {
      throw new DecodeError("codebooks: do not go on with those that came before");
    }
    for (const [name, book] of books) this.books.set(name, book);
  }

  private get list(): readonly Codebook[] {
    return [...this.books.values()];
  }

  /** Free the tables. */
  dispose(): void {
    for (const at of this.tables.values()) this.kernels.free(at);
    this.tables.clear();
  }

  /** The splats at `means` [n, 3], and their codes [attributes, n] with the `fresh` layers, one item an attribute in
   * coding order, appended to `before`. Raises {@link DecodeError} for layers of a wrong length. */
  run(means: Float32Array, before: Uint32Array | undefined, fresh: readonly FreshLayers[]): { splats: Splats; codes: Uint32Array } {
    const count = means.length / 3;
    const widths = [4, 3, 1, 3, 3 * SH_REST_OF_DEGREE[this.shDegree]!];
    return this.kernels.scoped((scope) => {
      const attributes = this.attributes(scope, fresh);
      const codes = before ? scope.put(before) : scope.take(4 * this.list.length * count);
      const columns = widths.map((width) => scope.take(4 * width * count));
      const { data, bytes } = this.data(scope, fresh);
      const [tile, targets] = [scope.take(TILE_BYTES), scope.take(TARGETS_BYTES)];
      const t = this.kernels.view(tile, TILE_BYTES);
      t.setBigInt64(0, BigInt(count), true);
      t.setUint32(8, before ? codes : 0, true);
      t.setUint32(12, data, true);
      t.setBigInt64(16, BigInt(before?.length ?? 0), true);
      t.setBigInt64(24, BigInt(bytes), true);
      t.setInt32(32, this.list.length, true);
      t.setInt32(36, this.rodrigues ? 1 : 0, true);
      widths.forEach((width, i) => t.setInt32(40 + 4 * i, width, true));
      this.kernels.u32(targets, 6).set([codes, ...columns]);
      this.kernels.writeLengths(targets + TARGETS_LENGTHS, [this.list.length, ...widths].map((width) => width * count));
      try {
        check("cags_codec_dequantise", this.kernels.calls.cags_codec_dequantise(tile, attributes, targets));
      } catch (error) {
        if (!(error instanceof KernelError)) throw error;
        throw new DecodeError(`layers of ${count} splats have ${bytes} bytes, which is another length`);
      }
      return { splats: this.splats(means, columns, widths), codes: this.kernels.u32(codes, this.list.length * count).slice() };
    });
  }

  /** Means [n, 3]: `origin` + `cells` [n, 3] x `step`, in double precision and then rounded. */
  positions(cells: Float32Array, origin: readonly number[], step: number): Float32Array<ArrayBuffer> {
    return this.kernels.scoped((scope) => {
      const [from, at, to] = [scope.put(cells), scope.put(Float64Array.from(origin)), scope.take(cells.byteLength)];
      const length = BigInt(cells.length);
      check("cags_codec_positions", this.kernels.calls.cags_codec_positions(from, length, at, step, to, length));
      return this.kernels.f32(to, cells.length).slice();
    });
  }

  private splats(means: Float32Array, columns: number[], widths: number[]): Splats {
    const count = means.length / 3;
    const out = COLUMNS.map((_, i) => this.kernels.f32(columns[i]!, widths[i]! * count).slice());
    if (this.logits) out[2]!.forEach((alpha, i) => (out[2]![i] = alphaLogit(alpha)));
    return { means, quats: out[0]!, log_scales: out[1]!, logit_opacities: out[2]!, sh0: out[3]!, sh_rest: out[4]! };
  }

  private attributes(scope: Scope, fresh: readonly FreshLayers[]): number {
    const described = this.list.map((book, i) => this.described(scope, book, fresh[i]!));
    const at = scope.take(ATTRIBUTE_BYTES * described.length);
    described.forEach(({ words, lengths }, i) => {
      this.kernels.u32(at + ATTRIBUTE_BYTES * i, words.length).set(words);
      this.kernels.writeLengths(at + ATTRIBUTE_BYTES * i + ATTRIBUTE_LENGTHS, lengths);
    });
    return at;
  }

  private described(scope: Scope, book: Codebook, { first, parts }: FreshLayers): { words: number[]; lengths: number[] } {
    const layers = first + parts.length;
    const below = book.belowBits(layers);
    const [column, offset] = PLACES.get(book.attribute)!;
    const bits = scope.put(Uint8Array.from(book.layerBits.slice(first, layers)));
    const two = [book.tables[book.firstStage - 1], book.spreads];
    const arrays = [book.tables[layers - 1], ...(below ? two : [undefined, undefined])];
    const words = [bits, ...arrays.map((array) => (array ? this.table(array) : 0)), parts.length, book.dim, below, column, offset];
    return { words, lengths: [parts.length, ...arrays.map((array) => array?.length ?? 0)] };
  }

  private table(values: Float32Array): number {
    let at = this.tables.get(values);
    if (at === undefined) this.tables.set(values, (at = this.kernels.block(values)));
    return at;
  }

  private data(scope: Scope, fresh: readonly FreshLayers[]): { data: number; bytes: number } {
    const parts = fresh.flatMap((layers) => layers.parts);
    const bytes = parts.reduce((sum, part) => sum + part.data.length, 0);
    const data = scope.take(bytes);
    let at = data;
    for (const part of parts) {
      this.kernels.u8(at, part.data.length).set(part.data);
      at += part.data.length;
    }
    return { data, bytes };
  }
}

/** Every attribute has to be there in one form, and in one alone. */
function checkForms(books: ReadonlyMap<string, Codebook>): void {
  const parts = books.has("rotation_real") && books.has("rotation_imag");
  const degree = SH_REST_ATTRIBUTES.filter((name) => books.has(name)).length;
  for (const name of ["scale", "sh0", ...SH_REST_ATTRIBUTES.slice(0, degree)]) {
    if (!books.has(name)) throw new DecodeError(`attribute '${name}' is missing; there are: ${[...books.keys()].join(", ")}`);
  }
  if (!books.has("rotation") && !parts) throw new DecodeError("attribute 'rotation' is missing");
  if (!books.has("alpha") && !books.has("opacity")) throw new DecodeError("attribute 'opacity' is missing");
  const twice = (books.has("alpha") && books.has("opacity")) ||
    (books.has("rotation") && (books.has("rotation_real") || books.has("rotation_imag")));
  if (twice) throw new DecodeError("an attribute comes in two forms; one is expected");
}
