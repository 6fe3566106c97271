/** The public part of a bundle's manifest, checked as `cags_common.bundle.manifest` does. */
import { BundleError } from "../bytes/errors.ts";
import { canonical } from "../player/vectors.ts";
import type { AuthorView, FrameRange, Quat, SceneInfo, Vec3 } from "../seam.ts";
import { MAX_LODS } from "../wire/limits.ts";
import { MAX_SPLATS } from "./packing.ts";

export const FORMAT = "cags-bundle";
export const VERSION = 9;
const MAX_MANIFEST_BYTES = 16 * 2 ** 20;
const MAX_FRAMES = 1_000_000;
/** Largest sum of the groups' capacities of a clip that decoders keep whole. */
const MAX_WHOLE_SPLATS = 1 << 20;
const MAX_BASE_BITS = 8;
const MAX_TITLE = 120;
const FARTHEST_M = 1e9;
const ONE_LINE = /^(?:[^\p{C}\p{Z}]| )*$/u;

/** One enhancement layer; `layer` counts from 1. */
export interface LodLayer {
  readonly attribute: string;
  readonly layer: number;
}

export interface FileEntry {
  readonly name: string;
  readonly indexOffset: number;
  readonly indexCrc: number;
  readonly sizeBytes: number;
}

/** PSNR of the lowest and the highest level where the encoder did not measure it; as `cags_client.frame.restore`. */
const [TYPICAL_BASE_DB, TYPICAL_TOP_DB] = [27, 51];

/** What a decoder needs besides what a player knows. */
export interface Manifest extends Omit<SceneInfo, "waits"> {
  readonly lodOrder: readonly LodLayer[];
  readonly lodGainsDb: readonly number[];
  /** Mean squared error that pictures of each LoD are expected to have, RGB from 0 to 1. */
  readonly lodErrors: readonly number[];
  /** Finest units of motion by the base code of scale: metres, and of a quaternion's imaginary part. */
  readonly motion: { readonly moves: readonly number[]; readonly turns: readonly number[] } | undefined;
  /** Where tiles lie; empty in the public part. */
  readonly files: readonly FileEntry[];
}

/** Parse and check. Raises {@link BundleError} naming the field; an unknown version is refused. */
export function readManifest(data: Uint8Array): Manifest {
  if (data.length > MAX_MANIFEST_BYTES) throw new BundleError(`manifest: ${data.length} bytes are too many`);
  let table: unknown;
  try {
    table = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(data));
  } catch (error) {
    throw new BundleError(`manifest: is not JSON (${(error as Error).message})`);
  }
  const fields = new Fields(table, "");
  if (!fields.isObject || (table as Record<string, unknown>)["format"] !== FORMAT) {
    throw new BundleError(`manifest: is not a ${FORMAT} manifest`);
  }
  const version = (table as Record<string, unknown>)["version"];
  if (version !== VERSION) throw new BundleError(`manifest: version ${String(version)} is unknown; this program reads ${VERSION}, encode again`);
  return checked(read(fields, table as Record<string, unknown>));
}

function read(fields: Fields, table: Record<string, unknown>): Manifest {
  const motion = fields.has("motion") ? readMotion(fields.inner("motion")) : undefined;
  const lodOrder = fields.many("lod_order", lodLayer, MAX_LODS - 1);
  const gofStarts = fields.many("gof_starts", (f) => f.integer("", 0, MAX_FRAMES), MAX_FRAMES);
  const capacity = fields.many("capacity", (f) => f.integer("", 0, MAX_SPLATS), MAX_FRAMES);
  const lods = lodOrder.length + 1;
  const lodGainsDb = fields.many("lod_gains_db", (f) => f.number("", -1e3, 1e3), MAX_LODS - 1);
  const baseDb = fields.has("base_psnr_db") ? fields.number("base_psnr_db", -1e3, 1e3) : TYPICAL_BASE_DB;
  return {
    name: fields.text("name"),
    fps: fields.number("fps", 1e-3, 1000),
    frames: fields.integer("frames", 1, MAX_FRAMES),
    gofStarts,
    capacity,
    keptWhole: gofStarts.length === 1 || capacity.reduce((sum, rows) => sum + rows, 0) <= MAX_WHOLE_SPLATS,
    shDegree: fields.integer("sh_degree", 0, 3) as 0 | 1 | 2 | 3,
    bounds: fields.corners("bounds"),
    lodOrder,
    lods,
    lodGainsDb,
    lodErrors: expectedDb(lods, baseDb, lodGainsDb).map((db) => 10 ** (-db / 10)),
    codec: fields.text("codec"),
    up: fields.vector("up"),
    focusCentre: fields.vector("focus_centre"),
    focusRadius: fields.number("focus_radius", 0, 1e12),
    near: fields.number("near", 1e-9, 1e9),
    motion,
    moves: motion !== undefined,
    view: fields.has("view") ? readView(fields.inner("view")) : {},
    files: fields.has("gofs") ? fields.many("gofs", (f) => fileEntry(f.inner("tiles")), MAX_FRAMES) : [],
    manifest: table,
  };
}

/** PSNR that pictures of each LoD are expected to have, as `cags_client.frame.restore.expected_psnr_db` says. */
function expectedDb(lods: number, baseDb: number, gainsDb: readonly number[]): number[] {
  const won = [0];
  for (const gain of gainsDb) won.push(won.at(-1)! + Math.max(gain, 0));
  if (won.at(-1)! > 0 && won.length === lods) return won.map((db) => baseDb + db);
  const range = Math.max(TYPICAL_TOP_DB - baseDb, 0);
  return Array.from({ length: lods }, (_, lod) => baseDb + Math.sqrt(lods > 1 ? lod / (lods - 1) : 1) * range);
}

function checked(m: Manifest): Manifest {
  const ends = [...m.gofStarts.slice(1), m.frames];
  if (!m.gofStarts.length || m.gofStarts[0] !== 0 || m.gofStarts.some((start, i) => start >= ends[i]!)) {
    throw new BundleError(`manifest: gof_starts must rise from 0 and stay below frames = ${m.frames}`);
  }
  if (m.capacity.length !== m.gofStarts.length || ![0, m.gofStarts.length].includes(m.files.length)) {
    throw new BundleError(`manifest: capacity and gofs must have one entry for each of the ${m.gofStarts.length} groups`);
  }
  if (![0, m.lodOrder.length].includes(m.lodGainsDb.length)) {
    throw new BundleError("manifest: lod_gains_db must be empty or have one entry for each LoD of lod_order");
  }
  return m;
}

/** The group that `frame` belongs to. Raises {@link BundleError} outside the bundle. */
export function gofOf(info: Pick<SceneInfo, "gofStarts" | "frames">, frame: number): number {
  if (!(frame >= 0 && frame < info.frames)) {
    throw new BundleError(`frame ${frame} is outside the bundle's frames 0 to ${info.frames - 1}`);
  }
  let low = 0;
  let high = info.gofStarts.length;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (info.gofStarts[middle]! <= frame) low = middle;
    else high = middle;
  }
  return low;
}

/** First frame of a group, and the first one after it. */
export function gofRange(info: Pick<SceneInfo, "gofStarts" | "frames">, gof: number): FrameRange {
  return [info.gofStarts[gof]!, info.gofStarts[gof + 1] ?? info.frames];
}

/** The part that pages may know, which can be posted between threads. */
export function sceneInfo(m: Manifest, waits: boolean): SceneInfo {
  const { lodOrder: _order, lodGainsDb: _gains, lodErrors: _errors, motion: _motion, files: _files, ...info } = m;
  return { ...info, waits };
}

function readMotion(fields: Fields): { moves: number[]; turns: number[] } {
  const steps = (name: string): number[] => fields.many(name, (f) => f.number("", 0, 1e12), 1 << MAX_BASE_BITS);
  const [moves, turns] = [steps("moves"), steps("turns")];
  if (moves.length !== turns.length) {
    throw new BundleError(`manifest: motion has ${moves.length} units of moves and ${turns.length} of turns`);
  }
  return { moves, turns };
}

/** See `cags_common.bundle.view`: every part is optional, and none is taken as it comes. */
function readView(fields: Fields): AuthorView {
  if (!fields.isObject) throw new BundleError("manifest: view must be an object with named fields");
  const metres = (name: string, count: number): number[] => {
    const parts = fields.many(name, (f) => f.number("", -FARTHEST_M, FARTHEST_M), count);
    return need(parts.length === count, name, `${count} numbers`, parts);
  };
  const view: { -readonly [name in keyof AuthorView]: AuthorView[name] } = {};
  if (fields.has("title")) {
    const title = fields.text("title");
    view.title = need([...title].length <= MAX_TITLE && ONE_LINE.test(title), "title", `one line of at most ${MAX_TITLE} characters`, title);
  }
  if (fields.has("background")) {
    const colour = fields.text("background");
    view.background = need(/^#[0-9a-f]{6}$/i.test(colour), "background", "a colour such as #1a2b3c", colour).toLowerCase();
  }
  if (fields.has("pose")) {
    const [x, y, z, ...turn] = metres("pose", 7) as [number, number, number, ...number[]];
    const norm = Math.hypot(...turn);
    need(norm > 0.5 && norm < 2, "pose", "x, y, z and a unit quaternion w, x, y, z", turn);
    view.pose = { position: [x, y, z], rotation: canonical(turn as unknown as Quat) };
  }
  if (fields.has("target")) view.target = metres("target", 3) as unknown as Vec3;
  if (fields.has("radius")) view.radius = fields.number("radius", 1e-6, FARTHEST_M);
  return view;
}

function need<T>(holds: boolean, name: string, wanted: string, value: T): T {
  if (!holds) throw new BundleError(`manifest: view.${name} = ${JSON.stringify(value).slice(0, 40)} must be ${wanted}`);
  return value;
}

function lodLayer(field: Fields): LodLayer {
  const parts = field.sequence("");
  if (parts.length !== 2) throw new BundleError("manifest: a lod_order entry must be [attribute, layer]");
  const layer = new Fields(parts[1], "lod_order").integer("", 1, MAX_LODS);
  return { attribute: new Fields(parts[0], "lod_order").text(""), layer };
}

function fileEntry(fields: Fields): FileEntry {
  const name = fields.text("name");
  if (!name || name.startsWith("/") || name.split("/").includes("..") || name.includes("\\") || name.includes(":")) {
    throw new BundleError(`manifest: file name '${name}' must stay inside the bundle`);
  }
  const sizeBytes = fields.integer("size_bytes", 0, 2 ** 50);
  const [indexOffset, indexCrc] = [fields.integer("index_offset", 0, sizeBytes), fields.integer("index_crc", 0, 2 ** 32 - 1)];
  return { name, indexOffset, indexCrc, sizeBytes };
}

/** Typed access to one parsed JSON value; errors name the path of the field. */
class Fields {
  private readonly value: unknown;
  private readonly path: string;

  constructor(value: unknown, path: string) {
    this.value = value;
    this.path = path;
  }

  get isObject(): boolean {
    return typeof this.value === "object" && this.value !== null && !Array.isArray(this.value);
  }

  has(name: string): boolean {
    return this.isObject && ((this.value as Record<string, unknown>)[name] ?? null) !== null;
  }

  inner(name: string): Fields {
    return new Fields(...this.get(name));
  }

  text(name: string): string {
    const [value, path] = this.get(name);
    if (typeof value !== "string" || value.length > 1024) throw new BundleError(`manifest: ${path} must be a short text`);
    return value;
  }

  integer(name: string, low: number, high: number): number {
    const [value, path] = this.get(name);
    const whole = typeof value === "number" && Number.isInteger(value) && value >= low && value <= high;
    if (!whole) throw new BundleError(`manifest: ${path} = ${String(value)} must be a whole number in [${low}, ${high}]`);
    return value;
  }

  number(name: string, low: number, high: number): number {
    const [value, path] = this.get(name);
    const inside = typeof value === "number" && value >= low && value <= high;
    if (!inside) throw new BundleError(`manifest: ${path} = ${String(value)} must be a number in [${low}, ${high}]`);
    return value;
  }

  vector(name: string): Vec3 {
    const parts = this.many(name, (f) => f.number("", -1e30, 1e30), 3);
    if (parts.length !== 3) throw new BundleError(`manifest: ${name || this.path} must be three numbers`);
    return parts as unknown as Vec3;
  }

  corners(name: string): readonly [Vec3, Vec3] {
    const corners = this.many(name, (f) => f.vector(""), 2);
    if (corners.length !== 2) throw new BundleError(`manifest: ${name} must be two corners`);
    return corners as unknown as [Vec3, Vec3];
  }

  sequence(name: string): unknown[] {
    const [value, path] = this.get(name);
    if (!Array.isArray(value)) throw new BundleError(`manifest: ${path} must be a list`);
    return value;
  }

  many<T>(name: string, readOne: (field: Fields) => T, most: number): T[] {
    const values = this.sequence(name);
    const [, path] = this.get(name);
    if (values.length > most) throw new BundleError(`manifest: ${path} has ${values.length} entries; at most ${most} are allowed`);
    return values.map((value, i) => readOne(new Fields(value, `${path}[${i}]`)));
  }

  private get(name: string): [unknown, string] {
    if (!name) return [this.value, this.path];
    const path = this.path ? `${this.path}.${name}` : name;
    if (!this.isObject || !Object.hasOwn(this.value as object, name)) throw new BundleError(`manifest: ${path} is missing`);
    return [(this.value as Record<string, unknown>)[name], path];
  }
}
