/** A chunk of motion as far as it has come, as `cags_common.motion.chunk`: format 7, up to four levels. */
import { DecodeError } from "../bytes/errors.ts";
import { unsqueeze } from "../bytes/inflate.ts";
import type { Kernels } from "../decode/kernels.ts";
import { classTables, CLASSES, KNOT_NUMBERS, knots } from "./knots.ts";

export const MOTION_VERSION = 7;
/** Levels of a chunk at most. */
export const LEVELS = 4;
const REFINEMENT = 4;
const MAX_SPAN = 64;
const MAX_SPLATS = 65_536;
const MAX_SAMPLES = 1 << 20;
const MAX_BLOCK = 4_096;
const MAX_FINER = 10;
const MAX_UNIT = 1e30;
const MAX_ESCAPES = 1 << 23;
const ESCAPE = 254;
const [STARTS, TURNS, LIVES, FADES, MOVES, STILLS, CURVED_MOVES, CURVED_TURNS] = [1, 2, 4, 8, 16, 32, 64, 128] as const;
const HEAD_BYTES = 40;
/** Size of the kernel's tree, and where the length of its classes is (`cags_motion.h`, pointers of 4 bytes). */
const [TREE_BYTES, TREE_LENGTHS] = [48, 40];
const FADE_WIDTHS = Array.from({ length: 48 }, (_, i) => 2 ** (i / 4 - 3));
const FADE_STEP = 4;
const LIFE_EDGES = [2, 3, 5, 8];
const LIFE_TABLE = 0;
const WIDTH_TABLE = 1;
const CENTRE_TABLE = WIDTH_TABLE + LIFE_EDGES.length + 2;
const MOVE_TABLE = CENTRE_TABLE + 2;
const TURN_TABLE = MOVE_TABLE + CLASSES + 1;
const REAL_TABLE = TURN_TABLE + CLASSES + 1;

/** Rigid motion of runs of `size` splats at each sample of the span. */
export interface Blocks {
  readonly size: number;
  /** Metres a unit of the shifts, float32. */
  readonly unit: number;
  readonly shifts: Int32Array; // [span + 1, blocks, 3]
  readonly turns: Int32Array; // [span + 1, blocks, 3] Gibbs vectors in 1 / 4096
}

/** What the payloads say so far. It never changes: a further level makes another one. */
export interface Chunk {
  /** Media frame and tile of the looks that move. */
  readonly looks: readonly [number, number];
  readonly span: number;
  readonly splats: number;
  readonly lives: Uint8Array | undefined; // [n]
  readonly fades: Float32Array | undefined; // [n, 2] centre, standard deviation; infinite: none
  readonly blocks: Blocks | undefined;
  readonly moves: Int32Array | undefined; // [span + 1, n, 3]
  readonly turns: Int32Array | undefined; // [span + 1, n, 4]
  readonly starts: boolean;
  /** How often the units of moves and of turns are the tile's halved. */
  readonly finer: readonly [number, number];
  /** Whether middles of moves and of turns are told against curves, not lines. */
  readonly curved: readonly [boolean, boolean];
}

interface Head {
  readonly flags: number;
  readonly span: number;
  /** Levels that say anything. */
  readonly levels: number;
  readonly looks: readonly [number, number];
  readonly splats: number;
  readonly block: number;
  readonly finer: readonly [number, number];
  readonly unit: number;
}

/** Media frame and tile of the looks that a payload of level 0 moves. Raises {@link DecodeError}. */
export function readLooks(payload: Uint8Array): readonly [number, number] {
  return sections(payload).head.looks;
}

/** One tile of motion; levels may come in any order. */
export class MotionTile {
  readonly kind = "motion";
  chunk: Chunk;
  private read = 1;
  /** Levels that say anything. */
  private readonly count: number;
  /** Where levels that were read had residuals: moves, turns. */
  private told: readonly (Uint8Array | undefined)[];
  private waiting = new Map<number, Uint8Array>();
  /** Rows of the splats of which levels speak; undefined: of all. */
  private readonly movers: Int32Array | undefined;
  /** Moves and turns [span + 1, movers, parts], as far as told. */
  private trees: Trees;
  private readonly kernels: Kernels;

  /** Decode level 0. Raises {@link DecodeError}. */
  constructor(payload: Uint8Array, kernels: Kernels) {
    this.kernels = kernels;
    const { head, rigid, who, escapes, symbols } = sections(payload);
    this.movers = readMovers(head, who);
    this.count = head.levels;
    const rows = (head.span + 1) * (this.movers?.length ?? head.splats);
    const told = [head.flags & MOVES ? new Uint8Array(3 * rows) : undefined, head.flags & TURNS ? new Uint8Array(4 * rows) : undefined];
    const { blank, trees } = withReader(kernels, escapes, symbols, (reader) => opened(head, rigid, reader, told));
    this.told = told;
    this.trees = trees;
    this.chunk = this.withTrees(blank);
  }

  get length(): number {
    return this.chunk.splats;
  }

  get looks(): readonly [number, number] {
    return this.chunk.looks;
  }

  /** Highest level up to which everything has come. */
  get lod(): number {
    return this.levels - 1;
  }

  /** Levels that there are, from the first on; those that are empty count from the last full one on. */
  private get levels(): number {
    return this.read < this.count ? this.read : LEVELS;
  }

  /** Take level `lod` >= 1; whether the motion changed. Raises {@link DecodeError}. */
  addLayer(lod: number, payload: Uint8Array): boolean {
    if (lod < 1 || lod >= LEVELS) throw new DecodeError(`motion: level ${lod} is outside 1 to ${LEVELS - 1}`);
    if (lod < this.levels) return false;
    this.waiting.set(lod, payload.slice());
    const before = this.levels;
    for (let level; (level = this.waiting.get(this.levels)); ) {
      this.waiting.delete(this.levels);
      this.addLevel(level);
    }
    return this.levels > before;
  }

  /** Another tile of what has come; what is added to one of the two does not change the other. */
  fork(): MotionTile {
    const other = Object.create(MotionTile.prototype) as MotionTile;
    Object.assign(other, this);
    other.waiting = new Map(this.waiting);
    return other;
  }

  /** Take the next level. Raises {@link DecodeError}, and then nothing is changed. */
  private addLevel(payload: Uint8Array): void {
    if (this.read >= this.count || payload.length < 4) {
      throw new DecodeError(`motion: level ${this.read} of ${this.count} is too much or cut short`);
    }
    const escapes = 4 + new DataView(payload.buffer, payload.byteOffset, 4).getUint32(0, true);
    if (escapes > payload.length) throw new DecodeError("motion: a level's escapes are cut short");
    const { chunk, read } = this;
    const told = this.told.map((part) => part?.slice());
    const [moves, turns] = withReader(this.kernels, payload.subarray(4, escapes), payload.subarray(escapes), (reader) => {
      const trees = readTrees(reader, chunk, read, told);
      reader.finish();
      return trees;
    });
    this.told = told;
    this.trees = [sum(this.trees[0], moves), sum(this.trees[1], turns)];
    this.chunk = this.withTrees(chunk);
    this.read += 1;
  }

  private withTrees(chunk: Chunk): Chunk {
    const of = (tree: Int32Array | undefined, parts: number): Int32Array | undefined => {
      const { movers } = this;
      return tree && movers ? scattered(tree, movers, chunk, parts) : tree;
    };
    return { ...chunk, moves: of(this.trees[0], 3), turns: of(this.trees[1], 4) };
  }
}

type Trees = readonly [Int32Array | undefined, Int32Array | undefined];

/** `tree` [span + 1, movers, parts] as of all splats. */
function scattered(tree: Int32Array, movers: Int32Array, { span, splats }: Chunk, parts: number): Int32Array {
  const out = new Int32Array((span + 1) * splats * parts);
  for (let sample = 0, from = 0; sample <= span; sample++) {
    for (const row of movers) {
      const to = (sample * splats + row) * parts;
      for (let part = 0; part < parts; part++) out[to + part] = tree[from++]!;
    }
  }
  return out;
}

/** Rows of the splats of which levels speak; undefined: of all. Raises {@link DecodeError}. */
function readMovers(head: Head, who: Uint8Array): Int32Array | undefined {
  if (!(head.flags & STILLS)) {
    if (who.length) throw new DecodeError("motion: says who moves, and that all do");
    return undefined;
  }
  const bits = unsqueeze(who, (head.splats + 7) >> 3, "motion: who moves");
  const rows: number[] = [];
  for (let i = 0; i < head.splats; i++) if ((bits[i >> 3]! >> (7 - (i & 7))) & 1) rows.push(i);
  return Int32Array.from(rows);
}

function sum(have: Int32Array | undefined, more: Int32Array | undefined): Int32Array | undefined {
  if (!have || !more) return have;
  for (let i = 0; i < more.length; i++) more[i] = (more[i]! + have[i]!) | 0;
  return more;
}

function sections(payload: Uint8Array): { head: Head; rigid: Uint8Array; who: Uint8Array; escapes: Uint8Array; symbols: Uint8Array } {
  if (payload.length < HEAD_BYTES) throw new DecodeError(`motion: ${payload.length} bytes are too few for a chunk`);
  const v = new DataView(payload.buffer, payload.byteOffset, HEAD_BYTES);
  const [version, flags, span, levels] = [v.getUint8(0), v.getUint8(1), v.getUint8(2), v.getUint8(3)];
  const [frame, tile, splats, block] = [v.getUint32(4, true), v.getUint32(8, true), v.getUint32(12, true), v.getUint16(16, true)];
  const [finer, finerTurns, unit] = [v.getUint8(18), v.getUint8(19), v.getFloat32(20, true)];
  const sizes = [24, 28, 32, 36].map((at) => v.getUint32(at, true)) as [number, number, number, number];
  const bent = (flags & CURVED_MOVES && !(flags & MOVES)) || (flags & CURVED_TURNS && !(flags & TURNS));
  if (version !== MOTION_VERSION || levels < 1 || levels > LEVELS || bent) {
    throw new DecodeError(`motion: version ${version}, ${levels} levels, flags ${flags}; this program reads ${MOTION_VERSION}`);
  }
  const small = splats <= MAX_SPLATS && splats * (span + 1) <= MAX_SAMPLES;
  const bounds = span >= 1 && span <= MAX_SPAN && small && block <= MAX_BLOCK && unit >= 0 && unit <= MAX_UNIT;
  const bytes = sizes[0] + sizes[1] + sizes[2] + sizes[3];
  if (!bounds || Math.max(finer, finerTurns) > MAX_FINER || bytes !== payload.length - HEAD_BYTES) {
    throw new DecodeError(`motion: claims a span of ${span}, ${splats} splats, ${bytes} bytes; beyond bounds`);
  }
  const rigid = HEAD_BYTES + sizes[0];
  const who = rigid + sizes[1];
  const escapes = who + sizes[2];
  const head = { flags, span, levels, looks: [frame, tile] as const, splats, block, finer: [finer, finerTurns] as const, unit };
  return {
    head, rigid: payload.subarray(HEAD_BYTES, rigid), who: payload.subarray(rigid, who),
    escapes: payload.subarray(who, escapes), symbols: payload.subarray(escapes),
  };
}

function opened(head: Head, rigid: Uint8Array, reader: SymbolReader, told: (Uint8Array | undefined)[]): { blank: Chunk; trees: Trees } {
  const { span, splats, flags } = head;
  const lives = flags & LIVES ? reader.plain(new Uint8Array(splats).fill(LIFE_TABLE)) : undefined;
  if (lives?.some((life) => life > span + 1)) throw new DecodeError(`motion: a life beyond a span of ${span}`);
  const fades = flags & FADES ? readFades(reader, head, lives) : undefined;
  const blank: Chunk = {
    looks: head.looks, span, splats, lives, fades, blocks: readBlocks(head, rigid), moves: undefined, turns: undefined,
    starts: (flags & STARTS) > 0, finer: head.finer, curved: [(flags & CURVED_MOVES) > 0, (flags & CURVED_TURNS) > 0],
  };
  const trees = readTrees(reader, blank, 0, told);
  reader.finish();
  return { blank, trees };
}

function readTrees(
  reader: SymbolReader, chunk: Chunk, level: number, told: (Uint8Array | undefined)[],
): [Int32Array | undefined, Int32Array | undefined] {
  const unit = REFINEMENT ** (LEVELS - 1 - level);
  const [moves, turns] = told.map((part, i) => {
    if (!part) return undefined;
    const tree = reader.tree(knots(chunk.span, chunk.starts, chunk.curved[i]!), part, chunk, i === 1);
    if (unit !== 1) for (let k = 0; k < tree.length; k++) tree[k] = Math.imul(tree[k]!, unit);
    return tree;
  });
  return [moves, turns];
}

function readFades(reader: SymbolReader, head: Head, lives: Uint8Array | undefined): Float32Array {
  const { span, splats } = head;
  const ends = (i: number): boolean => lives !== undefined && lives[i]! <= span;
  const kind = (i: number): number => (ends(i) ? LIFE_EDGES.filter((edge) => edge <= lives![i]!).length : LIFE_EDGES.length + 1);
  const widths = reader.plain(Uint8Array.from({ length: splats }, (_, i) => WIDTH_TABLE + kind(i)));
  if (widths.some((width) => width > FADE_WIDTHS.length)) throw new DecodeError("motion: a fade's width has an index beyond bounds");
  const fading = Array.from(widths.keys()).filter((i) => widths[i]);
  const centres = reader.signed(Uint8Array.from(fading, (i) => CENTRE_TABLE + (ends(i) ? 1 : 0)));
  const out = new Float32Array(2 * splats);
  for (let i = 0; i < splats; i++) out[2 * i + 1] = Infinity;
  fading.forEach((i, k) => {
    const width = FADE_WIDTHS[widths[i]! - 1]!;
    const middle = lives ? (lives[i]! - 1) / 2 : span / 2;
    out[2 * i] = middle + (centres[k]! * width) / FADE_STEP;
    out[2 * i + 1] = width;
  });
  return out;
}

function readBlocks(head: Head, rigid: Uint8Array): Blocks | undefined {
  if (!head.block) {
    if (rigid.length) throw new DecodeError("motion: has blocks of no size");
    return undefined;
  }
  const count = Math.ceil(head.splats / head.block);
  const samples = head.span + 1;
  const numbers = 6 * count * samples;
  const raw = unsqueeze(rigid, 4 * numbers, "motion: blocks");
  const [shifts, turns] = [new Int32Array(samples * count * 3), new Int32Array(samples * count * 3)];
  for (let part = 0, at = 0; part < 6; part++) {
    const to = part < 3 ? shifts : turns;
    for (let block = 0; block < count; block++) {
      for (let sample = 0, value = 0; sample < samples; sample++, at++) {
        const folded = raw[at]! | (raw[numbers + at]! << 8) | (raw[2 * numbers + at]! << 16) | (raw[3 * numbers + at]! << 24);
        value = (value + unfolded(folded)) | 0;
        to[(sample * count + block) * 3 + (part % 3)] = value;
      }
    }
  }
  return { size: head.block, unit: head.unit, shifts, turns };
}

/** Of a folded word: 0, -1, 1, -2, ... */
function unfolded(word: number): number {
  return (word >>> 1) ^ -(word & 1);
}

function readEscapes(data: Uint8Array): Int32Array {
  if (!data.length) return new Int32Array(0);
  if (data.length < 20) throw new DecodeError("motion: large residuals are cut short");
  const view = new DataView(data.buffer, data.byteOffset, 20);
  const [count, ...sizes] = [0, 4, 8, 12, 16].map((at) => view.getUint32(at, true)) as [number, ...number[]];
  const bytes = sizes.reduce((a, b) => a + b, 0);
  if (!(count > 0 && count <= MAX_ESCAPES) || bytes !== data.length - 20) {
    throw new DecodeError(`motion: ${count} large residuals in ${data.length} bytes; beyond bounds, or cut short`);
  }
  const words = new Int32Array(count);
  let at = 20;
  sizes.forEach((size, plane) => {
    const raw = unsqueeze(data.subarray(at, (at += size)), count, "motion: large residuals");
    for (let i = 0; i < count; i++) words[i]! |= raw[i]! << (8 * plane);
  });
  return words.map(unfolded);
}

const DAMAGE: ReadonlyMap<number, string> = new Map([
  [16, "end too early"], [17, "a table is asked for that they lack"], [18, "the data does not end where its symbols do"],
  [19, "header or tables are damaged"], [20, "large residuals are missing"],
]);

function checkData(status: number): void {
  if (status) throw new DecodeError(`symbols: ${DAMAGE.get(status) ?? `status ${status}`}`);
}

let classes: Uint8Array | undefined;

function withReader<T>(kernels: Kernels, escapes: Uint8Array, symbols: Uint8Array, work: (reader: SymbolReader) => T): T {
  const large = readEscapes(escapes);
  return kernels.scoped((scope) => {
    const bytes = kernels.calls.cags_symbols_decoder_bytes();
    const decoder = scope.take(Number(bytes));
    checkData(kernels.calls.cags_symbols_open(scope.put(symbols), BigInt(symbols.length), decoder, bytes));
    return work(new SymbolReader(kernels, decoder, large));
  });
}

/** Reads the symbols of one level, and the large numbers beside them. Raises {@link DecodeError} for damaged data. */
class SymbolReader {
  private readonly kernels: Kernels;
  private readonly decoder: number;
  private readonly escapes: Int32Array;
  private at = 0;

  constructor(kernels: Kernels, decoder: number, escapes: Int32Array) {
    this.kernels = kernels;
    this.decoder = decoder;
    this.escapes = escapes;
  }

  /** The next numbers, by the table of each. */
  plain(tables: Uint8Array): Uint8Array {
    return this.kernels.scoped((scope) => {
      const [which, out] = [scope.put(tables), scope.take(tables.length)];
      const length = BigInt(tables.length);
      checkData(this.kernels.calls.cags_symbols_take(this.decoder, which, length, out, length));
      return this.kernels.u8(out, tables.length).slice();
    });
  }

  /** The next numbers of either sign, by the table of each. */
  signed(tables: Uint8Array): Int32Array {
    return Int32Array.from(this.plain(tables), (folded) => {
      if (folded !== ESCAPE) return folded & 1 ? -((folded + 1) >> 1) : folded >> 1;
      if (this.at >= this.escapes.length) throw new DecodeError("motion: large residuals are missing");
      return this.escapes[this.at++]!;
    });
  }

  /** Samples [span + 1, n, parts] of one level, in 1 / 64 of its unit; `told` is changed. */
  tree(order: Int32Array, told: Uint8Array, chunk: Chunk, turn: boolean): Int32Array {
    const k = this.kernels;
    return k.scoped((scope) => {
      classes ??= classTables();
      const [knotsAt, classesAt, toldAt] = [scope.put(order), scope.put(classes), scope.put(told)];
      const [escapes, escape, samples] = [scope.put(this.escapes), scope.take(8), scope.take(4 * told.length)];
      const tree = scope.take(TREE_BYTES);
      const first = turn ? TURN_TABLE : MOVE_TABLE;
      const parts = turn ? 4 : 3;
      const numbers = [chunk.span, told.length / parts / (chunk.span + 1), parts, turn ? 1 : 0, order.length / KNOT_NUMBERS, first, REAL_TABLE];
      k.i32(tree, 9).set([...numbers, knotsAt, classesAt]);
      k.view(escape, 8).setBigInt64(0, BigInt(this.at), true);
      k.writeLengths(tree + TREE_LENGTHS, [classes.length]);
      const [large, length] = [BigInt(this.escapes.length), BigInt(told.length)];
      checkData(k.calls.cags_motion_decode_tree(tree, this.decoder, escapes, large, escape, toldAt, length, samples, length));
      this.at = Number(k.view(escape, 8).getBigInt64(0, true));
      told.set(k.u8(toldAt, told.length));
      return k.i32(samples, told.length).slice();
    });
  }

  /** Check that everything was read. */
  finish(): void {
    checkData(this.kernels.calls.cags_symbols_finish(this.decoder));
    if (this.at !== this.escapes.length) throw new DecodeError("motion: large residuals are left over");
  }
}
