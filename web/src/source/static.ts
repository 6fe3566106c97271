/**
 * A scene from a published folder on any web host: the player chooses tiles and levels itself and fetches them by ranges;
 * there are no references. `cags-encode --publish` writes such a folder.
 */
import { crc32 } from "../bytes/crc32.ts";
import { BundleError, DecodeError } from "../bytes/errors.ts";
import { gofOf, gofRange, type Manifest, readManifest, sceneInfo } from "../decode/manifest.ts";
import {
  type Camera, type ConnectOptions, type FrameRequest, type FrameUpdate, type Intrinsics, type FrameRange, type LinkState, NO_FRAMES, nowUs, type PlayState, type PoseSample,
  type SceneSource, type SourceEvent, within,
} from "../seam.ts";
import { viewCone } from "../store/gofBuffer.ts";
import { arrivalOf } from "../store/tileStore.ts";
import { frameAt } from "../wire/timeline.ts";
import { type FrameEntry, readIndex, type TileEntry } from "./bundleIndex.ts";
import { baseWishes, batch, type Range, ranges, refinements, type Wish } from "./plan.ts";
import { type Decoders, memoryMb, SceneStore, tooLarge } from "./scene.ts";
import { Meter } from "./status.ts";

const AT_ONCE = 4;
/** Play that the base is fetched ahead for, and that must be there before looks are refined. */
const HORIZON_S = 4;
const SAFE_S = 1;
/** Refinements are fetched for so long at a time, at what the link carries: the view may turn. */
const REFINE_S = 0.25;
const LEAST_REFINE_BYTES = 8 << 10;
const FIRST_GUESS_BPS = 4e6;
const FIRST_RETRY_MS = 250;
const MAX_RETRY_MS = 4000;
const STATUS_EVERY_MS = 250;

export type Fetch = (url: string, init?: RequestInit) => Promise<Response>;

interface Group {
  readonly frames: readonly FrameEntry[];
  /** Looks -> levels that are there or under way. */
  readonly levels: Map<TileEntry, number>;
  /** First media frame whose base has not been asked for. */
  asked: number;
  /** First media frame whose end has not been told: bases come in any order, ends do not. */
  told: number;
  /** Removed ids of frames whose base is there. */
  readonly ready: Map<number, Uint8Array>;
}

export class StaticSource implements SceneSource {
  private readonly decoders: Promise<Decoders>;
  private readonly fetchAt: Fetch;
  private base = "";
  private options!: ConnectOptions;
  private listen: (event: SourceEvent) => void = () => {};
  private manifest: Manifest | undefined; // known before its scene can be decoded
  private scene: SceneStore | undefined;
  private opened: Promise<SceneStore | undefined> = Promise.resolve(undefined);
  private readonly groups = new Map<number, Group | null>(); // null: its index is under way
  private inFlight = 0;
  private generation = 0; // raised by jumps: what was asked for before them is not stored
  private pose: PoseSample["pose"] = { position: [0, 0, 0], rotation: [1, 0, 0, 0] };
  private state: PlayState | undefined;
  private at = 0; // media frame on display, or sought
  private readonly meter = new Meter();
  private bps = FIRST_GUESS_BPS;
  private failures = 0;
  private first: "missing" | "asked" | "there" = "missing"; // bases up to the frame that a play or a jump begins with
  private ended = false;
  private timer: ReturnType<typeof setInterval> | undefined;

  /** `decoders` may be on their way still: the scene is looked up meanwhile. */
  constructor(decoders: Promise<Decoders>, fetchAt: Fetch = (url, init) => fetch(url, init)) {
    this.decoders = decoders;
    decoders.catch(() => undefined); // told when they are needed
    this.fetchAt = fetchAt;
  }

  // --------------------------------------------------------------------------------------------------------- SceneSource

  connect(url: string, options: ConnectOptions, listen: (event: SourceEvent) => void): void {
    this.base = url.endsWith("/") ? url : `${url}/`;
    this.options = options;
    this.listen = listen;
    this.pose = options.pose;
    this.timer = setInterval(() => this.tick(), STATUS_EVERY_MS);
    void this.begin();
  }

  control(state: PlayState): void {
    this.state = state;
    if (!this.scene) return;
    if (state.action === "seek" && !within(this.scene.kept, state.frame)) {
      this.generation += 1;
      this.first = "missing";
      this.groups.clear();
      this.scene.reset(state.frame);
      this.listen({ type: "flushed" });
    }
    this.at = state.frame;
    this.next();
  }

  get kept(): FrameRange {
    return this.scene?.kept ?? NO_FRAMES;
  }

  sendPoses(samples: readonly PoseSample[]): void {
    this.pose = samples.at(-1)?.pose ?? this.pose;
    this.next();
  }

  requestKeyframe(): void {}

  reshape(intrinsics: Intrinsics): void {
    this.options = { ...this.options, intrinsics };
  }

  async frame(request: FrameRequest): Promise<FrameUpdate> {
    if (!this.scene) throw new Error("no frame before the scene is known");
    this.at = request.frame;
    const update = this.scene.frame(request, this.camera());
    this.next();
    return update;
  }

  close(): void {
    this.ended = true;
    clearInterval(this.timer);
    this.scene?.dispose();
    this.scene = undefined;
  }

  private camera(): Camera {
    return { intrinsics: this.options.intrinsics, pose: this.pose, near: this.scene!.manifest.near };
  }

  // ------------------------------------------------------------------------------------------------------------ fetching

  /** Everything up to the first frame's base is fetched while the decoders are on their way. */
  private async begin(): Promise<void> {
    try {
      // its name stays when a folder is published again: a cache may hold the one before
      const manifest = readManifest(await this.whole("manifest.json", "no-cache"));
      this.at = frameAt(this.options.startSeconds ?? 0, manifest);
      const large = tooLarge(manifest, this.options.maxSplats ?? 4_000_000, this.options.maxMemoryMb ?? memoryMb());
      if (large) throw new BundleError(large);
      if (!manifest.files.length) throw new BundleError("manifest: does not say where tiles lie");
      this.opened = this.open(manifest);
      this.manifest = manifest;
      this.next();
      await this.opened;
      this.next();
    } catch (error) {
      this.fail(error);
    }
  }

  /** The scene, once its codebooks and the decoders are there; undefined: the viewer has left. */
  private async open(manifest: Manifest): Promise<SceneStore | undefined> {
    const published = manifest.manifest["published"] as { codebooks?: unknown } | undefined;
    const name = typeof published?.codebooks === "string" ? published.codebooks : "codebooks.bin";
    const [decoders, data] = await Promise.all([this.decoders, this.whole(name)]);
    if (this.ended) return undefined;
    const scene = new SceneStore(manifest, decoders, this.at);
    scene.codebooks(data);
    this.scene = scene;
    this.listen({ type: "info", info: sceneInfo(manifest, true) });
    return scene;
  }

  /** Start what is to be fetched next, while few requests are under way. */
  private next(): void {
    while (this.manifest && !this.ended && this.inFlight < AT_ONCE) {
      const work = this.chosen(this.manifest);
      if (!work) return;
      this.inFlight += 1;
      void work().catch((error: unknown) => this.fail(error)).finally(() => {
        this.inFlight -= 1;
        this.next();
      });
    }
  }

  private chosen(manifest: Manifest): (() => Promise<void>) | undefined {
    if (this.first === "asked") return undefined; // they have the link, and the decoders, to themselves
    const last = Math.min(this.at + Math.ceil(HORIZON_S * manifest.fps), manifest.frames - 1);
    for (let gof = gofOf(manifest, this.at); gof <= gofOf(manifest, last); gof++) {
      const group = this.groups.get(gof);
      if (group === undefined) return () => this.fetchIndex(manifest, gof);
      if (group === null) return undefined;
      const end = gofRange(manifest, gof)[1];
      if (group.asked <= last && group.asked < end) return this.baseOf(gof, group);
    }
    if (!this.scene) return undefined;
    const ahead = this.scene.store.ahead(this.at);
    const safe = Math.min(SAFE_S * manifest.fps, manifest.frames - 1 - this.at);
    return ahead >= safe || !this.playing ? this.refinement(manifest) : undefined;
  }

  private get playing(): boolean {
    return this.state?.action === "play" || this.state?.action === "rate";
  }

  private baseOf(gof: number, group: Group): () => Promise<void> {
    const left = group.frames.slice(group.asked - group.frames[0]!.frame);
    const frames = this.first === "there" ? batch(left) : left.slice(0, Math.max(1, this.at - group.asked + 1));
    if (this.first === "missing") this.first = "asked";
    group.asked += frames.length;
    for (const frame of frames) for (const entry of frame.tiles) if (entry.kind === "looks") group.levels.set(entry, 1);
    return () => this.fetchFrames(gof, group, frames);
  }

  /** The next levels of what is in view: of the group on display, of frames up to the horizon. */
  private refinement(manifest: Manifest): (() => Promise<void>) | undefined {
    const gof = gofOf(manifest, this.at);
    const group = this.groups.get(gof);
    if (!group) return undefined;
    const meets = viewCone(this.camera());
    const looks = [...group.levels.keys()].filter((entry) => entry.frame <= this.at + HORIZON_S * manifest.fps);
    const bytes = Math.max((this.bps / 8) * REFINE_S, LEAST_REFINE_BYTES) / AT_ONCE;
    const inView = (entry: TileEntry): boolean => meets(entry.sphere);
    const wishes = refinements(looks, (entry) => group.levels.get(entry)!, inView, manifest.lodGainsDb, bytes);
    if (!wishes.length) return undefined;
    for (const { entry, to } of wishes) group.levels.set(entry, to);
    return async () => {
      for (const range of ranges(wishes)) await this.fetchTiles(gof, range);
    };
  }

  private async fetchIndex(manifest: Manifest, gof: number): Promise<void> {
    const generation = this.generation;
    this.groups.set(gof, null);
    const { name, indexOffset, indexCrc, sizeBytes } = manifest.files[gof]!;
    const data = await this.checked(name, indexOffset, sizeBytes, (index) => crc32(index) === indexCrc);
    const [first, end] = gofRange(manifest, gof);
    const frames = readIndex(data, first, end - first, manifest.lods, `index of ${name}`);
    if (generation === this.generation) this.groups.set(gof, { frames, levels: new Map(), asked: first, told: first, ready: new Map() });
  }

  /** The bases of frames, and then their ends. */
  private async fetchFrames(gof: number, group: Group, frames: readonly FrameEntry[]): Promise<void> {
    const removed = new Map<FrameEntry, Uint8Array>();
    await Promise.all(ranges(frames.flatMap(baseWishes), frames).map((range) => this.fetchTiles(gof, range, removed)));
    await this.opened;
    for (const frame of frames) group.ready.set(frame.frame, removed.get(frame) ?? new Uint8Array(0));
    if (this.groups.get(gof) !== group) return;
    this.first = "there";
    for (let ids; this.scene && (ids = group.ready.get(group.told)); group.told++) {
      group.ready.delete(group.told);
      this.end(this.scene, group.told, ids);
    }
  }

  private end(scene: SceneStore, frame: number, removed: Uint8Array): void {
    try {
      scene.end(frame, removed);
      this.listen({ type: "whole", frame, mark: scene.mark });
    } catch (error) {
      if (!(error instanceof DecodeError)) throw error;
      this.meter.decodeErrors += 1;
    }
  }

  private async fetchTiles(gof: number, range: Range, removed?: Map<FrameEntry, Uint8Array>): Promise<void> {
    const generation = this.generation;
    const data = await this.checked(this.manifest!.files[gof]!.name, range.start, range.end, (part) => isIntact(part, range));
    const scene = await this.opened;
    for (const frame of range.removed) removed?.set(frame, removedIn(data, range, frame));
    for (const wish of range.wishes) {
      if (generation !== this.generation || !scene || this.ended) return;
      this.store(scene, wish, payloadsIn(data, range, wish));
      await breath(); // frames that are asked for meanwhile go first
    }
  }

  private store(scene: SceneStore, { entry, from }: Wish, payloads: readonly Uint8Array[]): void {
    this.meter.bytesTiles += payloads.reduce((sum, payload) => sum + payload.length, 0);
    this.meter.decodeErrors += scene.add([arrivalOf(entry.frame, entry.tile, from, payloads)]).length;
  }

  private async whole(name: string, cache: RequestCache = "default"): Promise<Uint8Array> {
    return this.retried(name, async () => {
      const response = await this.fetchAt(this.base + name, { cache });
      if (!response.ok) throw new HttpError(name, response.status);
      const data = new Uint8Array(await response.arrayBuffer());
      this.meter.bytesOther += data.length;
      return data;
    });
  }

  /** Part of a file, fetched again past all caches where it is not intact. Raises where that does not help. */
  private async checked(name: string, start: number, end: number, intact: (part: Uint8Array) => boolean): Promise<Uint8Array> {
    for (const cache of ["default", "reload"] as const) {
      const part = await this.bytes(name, start, end, cache);
      if (intact(part)) return part;
      this.meter.decodeErrors += 1;
    }
    throw new BundleError(`${name} was damaged or replaced; reload the page`);
  }

  private async bytes(name: string, start: number, end: number, cache: RequestCache): Promise<Uint8Array> {
    return this.retried(name, async () => {
      const begun = nowUs();
      const response = await this.fetchAt(this.base + name, { cache, headers: { Range: `bytes=${start}-${end - 1}` } });
      if (!response.ok) throw new HttpError(name, response.status);
      const body = new Uint8Array(await response.arrayBuffer());
      const now = nowUs();
      this.meter.received(body.length, now);
      const share = Math.max(this.inFlight, 1);
      this.bps += 0.2 * ((8e6 * body.length * share) / Math.max(now - begun, 1000) - this.bps);
      const data = response.status === 206 ? body : body.subarray(start, end); // a host without ranges sends all of it
      if (data.length !== end - start) throw new HttpError(name, response.status);
      return data;
    });
  }

  /** Until it succeeds: a host that is away may come back. Raises where it says that there is nothing. */
  private async retried<T>(name: string, work: () => Promise<T>): Promise<T> {
    for (let wait = FIRST_RETRY_MS; ; wait = Math.min(2 * wait, MAX_RETRY_MS)) {
      try {
        const done = await work();
        this.failures = 0;
        return done;
      } catch (error) {
        if (this.ended || (error instanceof HttpError && error.lasting)) throw error;
        if (!this.failures++) this.listen({ type: "error", error: { code: "lost", message: `${name} cannot be fetched; trying again`, fatal: false } });
        await new Promise((resolve) => setTimeout(resolve, wait));
      }
    }
  }

  private fail(error: unknown): void {
    if (this.ended) return;
    const message = error instanceof Error ? error.message : String(error);
    this.listen({ type: "error", error: { code: "scene", message, fatal: true } });
    this.close();
  }

  private tick(): void {
    const link: LinkState = this.failures ? "away" : this.scene ? "open" : "connecting";
    const status = {
      atUs: nowUs(), link, attempts: this.failures, ...this.meter.figures(nowUs()), undecodedBytes: 0, damagedPackets: 0,
      framesAhead: this.scene?.store.ahead(this.at) ?? 0, references: false,
    };
    this.listen({ type: "status", status });
    this.next();
  }
}

function removedIn(data: Uint8Array, { start }: Range, { removed: [from, to] }: FrameEntry): Uint8Array {
  return data.subarray(from - start, to - start);
}

/** The levels of a wish. */
function payloadsIn(data: Uint8Array, { start }: Range, { entry, from, to }: Wish): Uint8Array[] {
  const payloads: Uint8Array[] = [];
  for (let level = from; level < to; level++) payloads.push(data.subarray(entry.offsets[level]! - start, entry.offsets[level + 1]! - start));
  return payloads;
}

function isIntact(data: Uint8Array, range: Range): boolean {
  const removed = range.removed.every((frame) => crc32(removedIn(data, range, frame)) === frame.removedCrc);
  return removed && range.wishes.every((wish) => payloadsIn(data, range, wish).every((payload, i) => crc32(payload) === wish.entry.crcs[wish.from + i]));
}

/** A host's refusal; `lasting` where asking again would meet it again. */
class HttpError extends Error {
  readonly lasting: boolean;
  constructor(name: string, status: number) {
    super(`${name}: the web host answers ${status}; is the whole folder there?`);
    this.lasting = status >= 400 && status < 500 && status !== 408 && status !== 429;
  }
}

/** Let what waits in the event loop go first. */
function breath(): Promise<void> {
  return new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      port1.close();
      resolve();
    };
    port2.postMessage(0);
  });
}
