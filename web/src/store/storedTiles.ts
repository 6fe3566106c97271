/** Tiles of one group of frames as a store holds them, and motion by the looks that it moves. */
import { DecodeError } from "../bytes/errors.ts";
import type { LooksTile, Steps } from "../decode/looks.ts";
import type { Splats } from "../decode/splats.ts";
import type { UpdateTile, UpdateValues } from "../decode/updates.ts";
import { type Chunk, LEVELS, MotionTile } from "../motion/chunk.ts";
import { frameOf, type Key } from "./keys.ts";
import { type Version, Versions } from "./versions.ts";

/** A ball that holds a tile's means: x, y, z, radius. */
export type Sphere = readonly [number, number, number, number];

/** One tile of looks: what is decoded of it, which rows it brought, and how many of them it still owns. */
export class StoredLooks {
  readonly kind = "looks";
  readonly key: Key;
  readonly frame: number;
  readonly sphere: Sphere;
  readonly versions: Versions<LooksTile>;
  index = -1;
  owned = 0;
  shownLod = -1;
  replaced = false;
  /** Whether the lives of all its splats are over at the time shown. */
  ended = false;
  /** [n] in the tile's order. */
  ids: Int32Array = new Int32Array(0);
  steps: Steps | undefined;
  /** [n] ids of the splats that are the tile's still, -1 for the others; undefined: to be told anew. */
  rows: Int32Array | undefined;
  /** Whether {@link rows} names splats that are not the tile's any more. */
  lost = false;

  constructor(key: Key, sphere: Sphere, versions: Versions<LooksTile>) {
    this.key = key;
    this.frame = frameOf(key);
    this.sphere = sphere;
    this.versions = versions;
  }

  get onDisplay(): boolean {
    return this.owned > 0 && !this.ended;
  }

  get lods(): number {
    return this.versions.newest.lod + 1;
  }
}

/** A level of motion, and the last mark that came before it. */
export interface KeptPayload {
  readonly since: number;
  readonly data: Uint8Array;
}

/** One tile of motion: its payloads, and what is decoded of them (undefined once it is past). */
export class StoredMotion {
  readonly kind = "motion";
  readonly key: Key;
  readonly looks: Key;
  versions: Versions<MotionTile> | undefined;
  readonly payloads = new Map<number, KeptPayload>();
  shownLod = -1;

  constructor(key: Key, looks: Key, versions: Versions<MotionTile>) {
    this.key = key;
    this.looks = looks;
    this.versions = versions;
  }

  /** Levels that are held, from the lowest on without a gap. */
  get lods(): number {
    for (let level = 0; level < LEVELS; level++) if (!this.payloads.has(level)) return level;
    return LEVELS;
  }

  /** Decoded anew from the payloads, but for levels that are damaged; what came before mark `floor` as one. */
  opened(open: (payload: Uint8Array) => MotionTile, floor: number): Versions<MotionTile> {
    const { since, data } = this.payloads.get(0)!;
    const versions = new Versions(open(data), since);
    const later = [...this.payloads].filter(([level]) => level).sort((a, b) => a[1].since - b[1].since || a[0] - b[0]);
    for (const [level, kept] of later) {
      try {
        versions.writable(kept.since >= floor ? kept.since : since).addLayer(level, kept.data);
        versions.touch();
      } catch (error) {
        if (!(error instanceof DecodeError)) throw error;
      }
    }
    return versions;
  }
}

/** One update: what is decoded of it. */
export class StoredUpdate {
  readonly kind = "update";
  readonly key: Key;
  readonly versions: Versions<UpdateTile>;
  shownLod = -1;
  /** Column -> ids that it changes; known once it is shown. */
  idsOf: ReadonlyMap<string, Int32Array> = new Map();

  constructor(key: Key, versions: Versions<UpdateTile>) {
    this.key = key;
    this.versions = versions;
  }

  get lods(): number {
    return this.versions.newest.lod + 1;
  }
}

export type StoredTile = StoredLooks | StoredMotion | StoredUpdate;

/** A tile that the display may show, at the levels that there were before the mark after `since`. */
export type Staged = { readonly since: number; readonly lod: number } & (
  | { readonly held: StoredLooks; readonly ids: Int32Array; readonly splats: Splats; readonly steps: Steps | undefined }
  | { readonly held: StoredUpdate; readonly values: UpdateValues }
  | { readonly held: StoredMotion; readonly chunk: Chunk }
);

/** What is to be staged of a tile, a version each; nothing of motion that is past. */
export function toStage(held: StoredTile): Staged[] {
  if (held.kind === "looks") return held.versions.fresh().map((version) => stagedLooks(held, version));
  if (held.kind === "update") {
    return held.versions.fresh().map((version) => {
      const state = version.handedOut();
      return { held, since: version.since, lod: state.lod, values: state.values() };
    });
  }
  return (held.versions?.fresh() ?? []).map((version) => {
    const state = version.handedOut();
    return { held, since: version.since, lod: state.lod, chunk: state.chunk };
  });
}

function stagedLooks(held: StoredLooks, version: Version<LooksTile>): Staged {
  const state = version.handedOut();
  const splats = state.dequantise();
  return { held, since: version.since, lod: state.lod, ids: state.ids, splats, steps: state.steps };
}

/** Tiles of motion by the looks that they move, and those that wait for their looks. */
export class Motions {
  private readonly of_ = new Map<Key, Map<number, StoredMotion>>();
  private readonly orphans = new Map<Key, Set<Key>>();
  private readonly looksOf = new Map<Key, Key>(); // of those that wait

  /** Take a tile in; the one of the same looks and frame that it takes the place of. */
  add(held: StoredMotion): StoredMotion | undefined {
    let of = this.of_.get(held.looks);
    if (!of) this.of_.set(held.looks, (of = new Map()));
    const before = of.get(frameOf(held.key));
    of.set(frameOf(held.key), held);
    return before;
  }

  discard(held: StoredMotion): void {
    const of = this.of_.get(held.looks);
    if (of?.get(frameOf(held.key)) === held) of.delete(frameOf(held.key));
  }

  /** All that move tile `looks`. */
  of(looks: Key): StoredMotion[] {
    return [...(this.of_.get(looks)?.values() ?? [])];
  }

  /** The one that moves tile `looks` from media frame `start` on. */
  at(looks: Key, start: number): StoredMotion | undefined {
    return this.of_.get(looks)?.get(start);
  }

  /** Tiles that move. */
  looks(): Key[] {
    return [...this.of_.keys()];
  }

  /** Tile `key` waits for `looks`. */
  wait(key: Key, looks: Key): void {
    let waiting = this.orphans.get(looks);
    if (!waiting) this.orphans.set(looks, (waiting = new Set()));
    waiting.add(key);
    this.looksOf.set(key, looks);
  }

  /** Tile `key` waits no more. */
  giveUp(key: Key): void {
    const looks = this.looksOf.get(key);
    if (looks === undefined) return;
    this.looksOf.delete(key);
    const waiting = this.orphans.get(looks)!;
    waiting.delete(key);
    if (!waiting.size) this.orphans.delete(looks);
  }

  /** `looks` have come: the tiles that waited for them, in order. */
  come(looks: Key): Key[] {
    const keys = [...(this.orphans.get(looks) ?? [])].sort((a, b) => a - b);
    for (const key of keys) this.giveUp(key);
    return keys;
  }
}
