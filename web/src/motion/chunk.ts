/** A chunk of motion as far as it has come, as `cags_common.motion.chunk`: format 11, up to four levels. */
import { DecodeError } from "../bytes/errors.ts";
import { unsqueeze } from "../bytes/inflate.ts";
import { check, type Kernels } from "../decode/kernels.ts";
import { classTables, CLASSES, KNOT_NUMBERS, knots } from "./knots.ts";
import { pick } from "./parts.ts";

export const MOTION_VERSION = 11;
/** Levels of a chunk at most. */
export const LEVELS = 4;
const REFINEMENT = 4;
const MAX_SPAN = 64;
const MAX_SPLATS = 65_536;
const MAX_SAMPLES = 1 << 20;
const MAX_FINER = 10;
const MAX_ESCAPES = 1 << 23;
const ESCAPE = 254;
const [STARTS, LIVES, FADES, STILLS, CURVED_MOVES, CURVED_TURNS] = [1, 2, 4, 8, 16, 32] as const;
const FLAGS = STARTS | LIVES | FADES | STILLS | CURVED_MOVES | CURVED_TURNS;
const HEAD_BYTES = 31;
/** Size of the kernel's tree, and where the lengths of its arrays are (`cags_motion.h`, pointers of 4 bytes). */
const [TREE_BYTES, TREE_LENGTHS] = [88, 56];
const LEAST_UNIT = 1e-30;
/** Neighbours of a splat, and the numbers of each one's part in a fit. */
const [NEIGHBOURS, FIT] = [8, 8];
const FADE_WIDTHS = Array.from({ length: 48 }, (_, i) => 2 ** (i / 4 - 3));
const FADE_STEP = 4;
const LIFE_EDGES = [2, 3, 5, 8];
const LIFE_TABLE = 0;
/** Of the flags whether a knot has no residuals. */
const SILENT_TABLE = 1;
const WIDTH_TABLE = 2;
const CENTRE_TABLE = WIDTH_TABLE + LIFE_EDGES.length + 2;
const MOVE_TABLE = CENTRE_TABLE + 2;
const TURN_TABLE = MOVE_TABLE + CLASSES + 1;
const REAL_TABLE = TURN_TABLE + CLASSES + 1;

/** What motion is told by: the looks that move, as their first level decodes. */
export interface Anchors {
  readonly positions: Float32Array; // [n, 3] world, metres
  readonly moves: Float32Array; // [n] units of positions, metres
  readonly turns: Float32Array; // [n] units of rotations, radians of half an angle
}

/** What the payloads say so far. It never changes: a further level makes another one. */
export interface Chunk {
  /** Media frame and tile of the looks that move. */
  readonly looks: readonly [number, number];
  readonly span: number;
  readonly splats: number;
  readonly lives: Uint8Array | undefined; // [n]
  readonly fades: Float32Array | undefined; // [n, 2] centre, standard deviation; infinite: none
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
  /** Levels that say anything of moves and of turns. */
  readonly levels: readonly [number, number];
  readonly looks: readonly [number, number];
  readonly splats: number;
  readonly finer: readonly [number, number];
}

/** Moves or turns of the splats that move, as far as told. */
interface Samples {
  readonly turn: boolean;
  readonly levels: number;
  readonly span: number;
  readonly order: Int32Array;
  readonly units: Float32Array; // in parts of the largest
  readonly values: Int32Array; // [span + 1, m, parts] in 1 / 64 of the finest unit
  readonly told: Uint8Array; // where a level had a residual
}

type Parts = readonly [Samples | undefined, Samples | undefined];

interface Neighbours {
  readonly rows: Int32Array; // [m, 8]
  readonly fits: Float32Array; // [m, 8, 8]
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
  private waiting = new Map<number, Uint8Array>();
  /** Rows of the splats of which levels speak; undefined: of all. */
  private readonly movers: Int32Array | undefined;
  /** Of the splats that move; undefined once no level is to come. */
  private near: Neighbours | undefined;
  private parts: Parts;
  private readonly kernels: Kernels;

  /** Decode level 0; `anchors` [n] are the looks that move. Raises {@link DecodeError}. */
  constructor(payload: Uint8Array, anchors: Anchors, kernels: Kernels) {
    this.kernels = kernels;
    const { head, who, escapes, symbols } = sections(payload);
    checkAnchors(anchors, head.splats);
    this.movers = readMovers(head, who);
    this.count = Math.max(1, ...head.levels);
    const moving = this.movers ? some(anchors, this.movers) : anchors;
    const near = (this.near = neighbours(kernels, moving));
    this.parts = [nothingTold(head, moving, 0), nothingTold(head, moving, 1)];
    const blank = withReader(kernels, escapes, symbols, (reader) => {
      const opening = opened(head, reader);
      for (const part of this.parts) if (part) reader.tree(part, near, 0);
      reader.finish();
      return opening;
    });
    this.chunk = this.withParts(blank);
    this.dropWhenWhole();
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
    const { read, near } = this;
    const parts = this.parts.map((part) => part && { ...part, values: part.values.slice(), told: part.told.slice() });
    withReader(this.kernels, payload.subarray(4, escapes), payload.subarray(escapes), (reader) => {
      for (const part of parts) if (part && near && read < part.levels) reader.tree(part, near, read);
      reader.finish();
    });
    this.parts = [parts[0], parts[1]];
    this.chunk = this.withParts(this.chunk);
    this.read += 1;
    this.dropWhenWhole();
  }

  private dropWhenWhole(): void {
    if (this.read < this.count) return;
    this.near = undefined;
    this.parts = [undefined, undefined];
  }

  private withParts(chunk: Chunk): Chunk {
    const of = (part: Samples | undefined): Int32Array | undefined => {
      const { movers } = this;
      return part && movers ? scattered(part.values, movers, chunk, part.turn ? 4 : 3) : part?.values;
    };
    return { ...chunk, moves: of(this.parts[0]), turns: of(this.parts[1]) };
  }
}

function checkAnchors({ positions, moves, turns }: Anchors, splats: number): void {
  if (moves.length !== splats) throw new DecodeError(`motion: ${splats} splats move, and the looks have ${moves.length}`);
  const sound = (column: Float32Array): boolean => column.every(Number.isFinite);
  if (![positions, moves, turns].every(sound)) throw new DecodeError("motion: positions or units of the looks are not finite");
}

function some({ positions, moves, turns }: Anchors, rows: Int32Array): Anchors {
  return { positions: pick(positions, rows, 3), moves: pick(moves, rows), turns: pick(turns, rows) };
}

/** In parts of the largest, at least {@link LEAST_UNIT}; ones where that is none. */
function relative(units: Float32Array): Float32Array {
  let most = 0;
  for (const unit of units) if (unit > most) most = unit;
  return units.map((unit) => (most > 0 ? Math.max(unit / most, LEAST_UNIT) : 1));
}

function neighbours(kernels: Kernels, { positions, moves }: Anchors): Neighbours {
  const each = NEIGHBOURS * moves.length;
  return kernels.scoped((scope) => {
    const [at, units, rows, fits] = [scope.put(positions), scope.put(relative(moves)), scope.take(4 * each), scope.take(4 * FIT * each)];
    const [places, count, near, numbers] = [positions.length, moves.length, each, FIT * each].map(BigInt) as [bigint, bigint, bigint, bigint];
    check("cags_motion_neighbours", kernels.calls.cags_motion_neighbours(at, places, units, count, rows, near, fits, numbers));
    return { rows: kernels.i32(rows, each).slice(), fits: kernels.f32(fits, FIT * each).slice() };
  });
}

function nothingTold(head: Head, anchors: Anchors, part: 0 | 1): Samples | undefined {
  const { span, flags } = head;
  const [levels, turn, count] = [head.levels[part], part === 1, (span + 1) * anchors.moves.length * (3 + part)];
  if (!levels) return undefined;
  const order = knots(span, (flags & STARTS) > 0, (flags & (turn ? CURVED_TURNS : CURVED_MOVES)) > 0);
  const units = relative(turn ? anchors.turns : anchors.moves);
  return { turn, levels, span, order, units, values: new Int32Array(count), told: new Uint8Array(count) };
}

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

function sections(payload: Uint8Array): { head: Head; who: Uint8Array; escapes: Uint8Array; symbols: Uint8Array } {
  if (payload.length < HEAD_BYTES) throw new DecodeError(`motion: ${payload.length} bytes are too few for a chunk`);
  const v = new DataView(payload.buffer, payload.byteOffset, HEAD_BYTES);
  const [version, flags, span, moves, turns] = [0, 1, 2, 3, 4].map((at) => v.getUint8(at)) as [number, number, number, number, number];
  const [frame, tile, splats] = [v.getUint32(5, true), v.getUint32(9, true), v.getUint32(13, true)];
  const [finer, finerTurns] = [v.getUint8(17), v.getUint8(18)];
  const sizes = [19, 23, 27].map((at) => v.getUint32(at, true)) as [number, number, number];
  const bent = (flags & CURVED_MOVES && !moves) || (flags & CURVED_TURNS && !turns);
  if (version !== MOTION_VERSION || Math.max(moves, turns) > LEVELS || flags & ~FLAGS || bent) {
    throw new DecodeError(`motion: version ${version}, ${moves} and ${turns} levels, flags ${flags}; this program reads ${MOTION_VERSION}`);
  }
  const small = splats <= MAX_SPLATS && splats * (span + 1) <= MAX_SAMPLES;
  const bounds = span >= 1 && span <= MAX_SPAN && small && Math.max(finer, finerTurns) <= MAX_FINER;
  const bytes = sizes[0] + sizes[1] + sizes[2];
  if (!bounds || bytes !== payload.length - HEAD_BYTES) {
    throw new DecodeError(`motion: claims a span of ${span}, ${splats} splats, ${bytes} bytes; beyond bounds`);
  }
  const who = HEAD_BYTES + sizes[0];
  const escapes = who + sizes[1];
  const head = { flags, span, levels: [moves, turns] as const, looks: [frame, tile] as const, splats, finer: [finer, finerTurns] as const };
  return {
    head, who: payload.subarray(HEAD_BYTES, who), escapes: payload.subarray(who, escapes), symbols: payload.subarray(escapes),
  };
}

function opened(head: Head, reader: SymbolReader): Chunk {
  const { span, splats, flags } = head;
  const lives = flags & LIVES ? reader.plain(new Uint8Array(splats).fill(LIFE_TABLE)) : undefined;
  if (lives?.some((life) => life > span + 1)) throw new DecodeError(`motion: a life beyond a span of ${span}`);
  const fades = flags & FADES ? readFades(reader, head, lives) : undefined;
  return {
    looks: head.looks, span, splats, lives, fades, moves: undefined, turns: undefined,
    starts: (flags & STARTS) > 0, finer: head.finer, curved: [(flags & CURVED_MOVES) > 0, (flags & CURVED_TURNS) > 0],
  };
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

  /** Take `part` on by `level`. */
  tree(part: Samples, near: Neighbours, level: number): void {
    const k = this.kernels;
    const { span, order, units, values, told, turn } = part;
    k.scoped((scope) => {
      classes ??= classTables();
      const [knotsAt, classesAt, toldAt, samples] = [scope.put(order), scope.put(classes), scope.put(told), scope.put(values)];
      const [rows, fits, unitsAt] = [scope.put(near.rows), scope.put(near.fits), scope.put(units)];
      const [escapes, escape, tree] = [scope.put(this.escapes), scope.take(8), scope.take(TREE_BYTES)];
      const [parts, splats] = [turn ? 4 : 3, units.length];
      const unit = REFINEMENT ** (LEVELS - 1 - level);
      const tables = [turn ? TURN_TABLE : MOVE_TABLE, REAL_TABLE, SILENT_TABLE];
      const numbers = [span, splats, parts, turn ? 1 : 0, order.length / KNOT_NUMBERS, ...tables, unit];
      k.i32(tree, 14).set([...numbers, knotsAt, classesAt, rows, fits, unitsAt]);
      k.view(escape, 8).setBigInt64(0, BigInt(this.at), true);
      k.writeLengths(tree + TREE_LENGTHS, [classes.length, near.rows.length, near.fits.length, units.length]);
      const [large, length] = [BigInt(this.escapes.length), BigInt(told.length)];
      checkData(k.calls.cags_motion_decode_tree(tree, this.decoder, escapes, large, escape, toldAt, length, samples, length));
      this.at = Number(k.view(escape, 8).getBigInt64(0, true));
      told.set(k.u8(toldAt, told.length));
      values.set(k.i32(samples, values.length));
    });
  }

  /** Check that everything was read. */
  finish(): void {
    checkData(this.kernels.calls.cags_symbols_finish(this.decoder));
    if (this.at !== this.escapes.length) throw new DecodeError("motion: large residuals are left over");
  }
}
