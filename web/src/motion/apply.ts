/** Where the splats of tiles are at a time: by the motion kernel, as `cags_common.motion.apply`, to the same bits. */
import { check, type Kernels } from "../decode/kernels.ts";
import type { Steps } from "../decode/looks.ts";
import type { Chunk } from "./chunk.ts";
import { partOf, pick, restless } from "./parts.ts";

/** Opacity logit of a splat that is not there: every rasteriser culls it. */
export const ABSENT_LOGIT = -30;

/** Sizes of the kernel's structures, and where the lengths of their arrays begin (`cags_motion.h`, pointers of 4 bytes). */
const [TILE_BYTES, TILE_LENGTHS, ARRAYS_BYTES, ARRAYS_LENGTHS] = [120, 64, 80, 32];

/** Addresses in the kernels' memory of columns by id. */
export interface MovingColumns {
  readonly means: number;
  readonly quats: number;
  readonly logits: number;
}

/** One tile's part of {@link moveRows}: copies in the kernels' memory, to be disposed of. A splat belongs to one tile at
 * most; `rows` [n] are those of the splats in the arrays by id, -1 where they are not the tile's any more. */
export class MovingTile {
  /** Frames from the chunk's first. */
  time = 0;
  readonly chunk: Chunk;
  readonly rows: Int32Array;
  /** Those of `rows` that are the tile's and not left out, ascending. */
  owned: Int32Array;
  readonly steps: Steps;
  private readonly kernels: Kernels;
  private readonly blocks: number[] = [];
  private part: MovingTile | undefined;
  /** Splats of the tile that {@link part} is made of; undefined: all. */
  private splatsOfPart: Int32Array | undefined;
  private readonly rowsAt: number;
  /** Splats of the tile's own rows, by their rows. */
  private byRow: Int32Array;
  /** Frame of the chunk up to which splats that have ended are left out; -1: none are. */
  private ended = -1;
  private readonly structure = new DataView(new ArrayBuffer(TILE_BYTES));

  constructor(kernels: Kernels, chunk: Chunk, rows: Int32Array, steps: Steps) {
    this.kernels = kernels;
    this.chunk = chunk;
    this.rows = rows;
    this.byRow = Int32Array.from(rows.keys()).filter((i) => rows[i]! >= 0).sort((a, b) => rows[a]! - rows[b]!);
    this.owned = pick(rows, this.byRow);
    this.steps = steps;
    const [moveUnits, turnUnits] = units(chunk, steps);
    const s = this.structure;
    [chunk.splats, chunk.span].forEach((value, i) => s.setInt32(4 * i, value, true));
    const arrays = [rows, chunk.moves, chunk.turns, moveUnits, turnUnits, chunk.lives, chunk.fades];
    arrays.forEach((array, i) => {
      s.setUint32(32 + 4 * i, array ? this.keep(array) : 0, true);
      s.setBigInt64(TILE_LENGTHS + 8 * i, BigInt(array?.length ?? 0), true);
    });
    this.rowsAt = this.blocks[0]!;
  }

  /** Write what the kernel takes to `at`. */
  writeTo(at: number): void {
    const { time, sample, share } = momentOf(this.chunk, this.time);
    this.structure.setInt32(8, sample, true);
    this.structure.setFloat64(16, time, true);
    this.structure.setFloat64(24, share, true);
    this.kernels.u8(at, TILE_BYTES).set(new Uint8Array(this.structure.buffer));
  }

  /** The whole tile. */
  whole(): this {
    this.leaveOut(-1);
    return this;
  }

  /** The part of the tile that the way from `since`, of the same chunk, to the tile's time changes: all others keep what an
   * evaluation at `since` gave them, bit by bit. Undefined: from anywhere in the chunk, with splats that have ended. */
  inMotion(since: number | undefined): MovingTile {
    this.part ??= this.parted();
    this.part.time = this.time;
    const whole = (time: number): number => Math.min(Math.max(Math.floor(time), 0), this.chunk.span);
    this.part.leaveOut(since === undefined ? -1 : whole(Math.min(since, this.time)));
    return this.part;
  }

  /** From now on the tile is without `those` [n] of its splats that are not 0. */
  lose(those: Uint8Array): void {
    those.forEach((lost, i) => { if (lost) this.rows[i] = -1; });
    this.byRow = this.byRow.filter((i) => this.rows[i]! >= 0);
    this.writeRows();
    if (this.part && this.part !== this) this.part.lose(pick(those, this.splatsOfPart!));
  }

  /** Leave out splats that have ended by frame `until` of the chunk, and no others. */
  private leaveOut(until: number): void {
    if (!this.chunk.lives || until === this.ended) return;
    this.ended = until;
    this.writeRows();
  }

  private writeRows(): void {
    const { lives } = this.chunk;
    const there = (i: number): boolean => !lives || lives[i]! > this.ended;
    this.kernels.i32(this.rowsAt, this.rows.length).set(this.rows.map((row, i) => (there(i) ? row : -1)));
    this.owned = pick(this.rows, this.byRow.filter(there));
  }

  private parted(): MovingTile {
    const of = this.splatsOfPart = restless(this.chunk);
    if (!of) return this;
    const steps = { moves: pick(this.steps.moves, of), turns: pick(this.steps.turns, of) };
    return new MovingTile(this.kernels, partOf(this.chunk, of), pick(this.rows, of), steps);
  }

  /** Free the copies. */
  dispose(): void {
    if (this.part !== this) this.part?.dispose();
    this.part = undefined;
    for (const at of this.blocks) this.kernels.free(at);
    this.blocks.length = 0;
  }

  private keep(array: Int32Array | Float32Array | Uint8Array): number {
    const at = this.kernels.block(array);
    this.blocks.push(at);
    return at;
  }
}

/** Evaluate the splats of `tiles`: from rows of `from` to the same rows of `into`, columns by id of `capacity` rows. */
export function moveRows(kernels: Kernels, tiles: readonly MovingTile[], capacity: number, from: MovingColumns, into: MovingColumns): void {
  kernels.scoped((scope) => {
    const [given, arrays] = [scope.take(TILE_BYTES * tiles.length), scope.take(ARRAYS_BYTES)];
    tiles.forEach((tile, i) => tile.writeTo(given + TILE_BYTES * i));
    kernels.view(arrays, 8).setBigInt64(0, BigInt(capacity), true);
    kernels.u32(arrays + 8, 6).set([from.means, from.quats, from.logits, into.means, into.quats, into.logits]);
    kernels.writeLengths(arrays + ARRAYS_LENGTHS, [3, 4, 1, 3, 4, 1].map((width) => width * capacity));
    check("cags_motion_rows", kernels.calls.cags_motion_rows(given, tiles.length, arrays, 1));
  });
}

/** Finest units [n] of the chunk's positions and rotations: those of the tile, halved. */
function units(chunk: Chunk, steps: Steps): [Float32Array, Float32Array] {
  const [moves, turns] = chunk.finer.map((halvings) => 0.5 ** halvings) as [number, number];
  return [steps.moves.map((step) => step * moves), steps.turns.map((step) => step * turns)];
}

/** `time` frames from the chunk's first, held within its span: `share` of the way from `sample` to the next. */
function momentOf(chunk: Chunk, time: number): { time: number; sample: number; share: number } {
  const held = Math.min(Math.max(time, 0), chunk.span);
  const sample = Math.min(Math.floor(held), chunk.span - 1);
  return { time: held, sample, share: held - sample };
}

/** Frames after a chunk's first from which on nothing changes. */
export function endOf(chunk: Chunk): number {
  return endsAll(chunk) ? mostOf(chunk.lives!) : chunk.span;
}

/** Whether no splat of a chunk outlives its span. */
export function endsAll(chunk: Chunk): boolean {
  return chunk.lives !== undefined && mostOf(chunk.lives) <= chunk.span;
}

function mostOf(lives: Uint8Array): number {
  let most = 0;
  for (const life of lives) if (life > most) most = life;
  return most;
}
