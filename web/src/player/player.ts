/**
 * Plays a scene: which media frame is shown when, with which reference, from where.
 *
 * The state of play is a {@link Timeline}. Every wish makes a new one and tells the source. A seek keeps the picture until
 * the frame it went to has come whole. {@link Player.step} is called once a refresh of the screen; at most one frame is
 * under way.
 */

import { atHalfResolution, CLASSIC, type Exactness, type Footprint } from "../gpu/layout.ts";
import type { CodedReference, FrameOptions, FrameTimes, Renderer } from "../gpu/renderer.ts";
import { doubted } from "../playback/doubt.ts";
import { apart, validShare } from "../playback/reach.ts";
import { References } from "../playback/references.ts";
import { type Camera, type FrameUpdate, type Intrinsics, nowUs, type PlayState, type Pose, type PoseSample, type Reference, type SceneInfo, type SceneSource, type SourceError, type SourceEvent, type Status, within } from "../seam.ts";
import { ReferenceVideo } from "../video/stream.ts";
import { frameAt, Timeline } from "../wire/timeline.ts";
import { newestDue, nextDue, Quality } from "./quality.ts";
import { Startup, STARTUP_US } from "./startup.ts";
import { cellBoxes } from "./veto.ts";

/** From asking to play to the first frame. */
const START_DELAY_US = 250_000;
/** How long the old picture stays after a seek when the first frame does not come whole. */
const SEEK_PATIENCE_US = 15_000_000;
/** Play that must be there before one goes on that ran out of data. */
const REFILL_S = 1;
/** An end of the clip that is later than that was slept through. */
const JUMP_US = 1_000_000;
/** Media frames after which a reference is too old; it fades over the last half. */
const REFERENCE_AGE = 10;
/** Shares of the full picture's width that are drawn, where the device may choose. */
const SCALES = [0.35, 0.5, 0.7, 1];
const WHOLE = [1];
/** Of the screen, until it has been watched; shorter and longer pauses are not those of a screen. */
const REFRESH_US = 1e6 / 60;
const [SHORTEST_REFRESH_US, LONGEST_REFRESH_US] = [1000, 50_000] as const;
/** Weight of the newest refresh in their mean. */
const MEMORY = 0.05;
/** A refresh is the one that a picture is due at from this share of a step before it on. */
const NEARLY = 0.25;
/** Poses are kept for the next message; the oldest go first. */
const MOST_SAMPLES = 64;

/** What a picture is drawn of. */
export interface Viewed {
  readonly pose: Pose;
  readonly intrinsics: Intrinsics;
}

/** From where the viewer looks, and with what the server is told that they see; in a headset each eye has a picture of its own. */
export interface Viewpoint extends Viewed {
  readonly eyes?: readonly Viewed[];
}

export interface PlayerOptions {
  /** Of the clip, where the play begins; beyond its end at the last frame. */
  readonly startSeconds: number;
  readonly playing: boolean;
  readonly loop: boolean;
  /** Speed: 1 as the clip was made. */
  readonly rate: number;
  /** Draw fewer pixels while the device is too slow. */
  readonly adaptResolution: boolean;
  readonly exactness: Exactness;
  /** Add what references say is lacking. */
  readonly correct: boolean;
}

/** What was shown last. */
export interface Shown {
  readonly frame: number;
  readonly share: number;
  readonly camera: Camera;
  readonly reference: Reference | undefined;
  readonly update: FrameUpdate;
  readonly times: FrameTimes;
  /** From the pose to the picture on the canvas, ms. */
  readonly frameMs: number;
  readonly atUs: number;
  readonly options: FrameOptions;
}

export interface PlayerEvents {
  /** A picture of one of the viewpoint's `of` eyes; whoever hears it closes it. */
  drew?(eye: number, of: number, camera: Camera, picture: ImageBitmap): void;
  /** Something that a page shows has changed: the state of play, a frame, the link. */
  changed(): void;
  info(info: SceneInfo): void;
  failed(error: SourceError): void;
  notice(message: string): void;
}

type Decoded = References<CodedReference | null>;

/** What is waited for: a frame that is past has come, or it is `untilUs`; jumps are to be flushed before. */
interface Awaited {
  /** First and last media frame: of a jump one. */
  readonly frames: readonly [number, number];
  readonly untilUs: number;
  flushes: number;
  /** When the play ran out of data. */
  readonly stalledUs?: number;
}

export class Player {
  info: SceneInfo | null = null;
  status: Status | null = null;
  shown: Shown | null = null;
  playing: boolean;
  loop: boolean;
  rate: number;
  /** The media frame on display, or that the play goes to. */
  frame = 0;
  correct: boolean;
  exactness: Exactness;
  adaptResolution: boolean;
  /** Pictures shown, of all kinds. */
  pictures = 0;
  /** Media frames whose data was not there in time. */
  missed = 0;
  /** How often the play waited for data, and for how long together: of a source that is not live. */
  stalls = 0;
  stalledMs = 0;
  readonly #source: SceneSource;
  #renderer!: Renderer; // there once `#ready`
  readonly #events: PlayerEvents;
  readonly #view: () => Viewpoint;
  readonly #video: ReferenceVideo;
  readonly #references: Decoded = new References<CodedReference | null>();
  readonly #quality = new Quality(WHOLE, REFRESH_US);
  readonly #startSeconds: number;
  #startFrame = 0; // known with the scene
  #startup: Startup;
  #holdUs = STARTUP_US; // of the first frame, at most
  #samples: PoseSample[] = [];
  #timeline = new Timeline(1, 1);
  #startedUs: number | null = null;
  #nextTick = 0;
  #endTick = 1;
  #dueUs: number | null = null;
  #wanted: number | null = null;
  #awaited: Awaited | null = null;
  readonly #whole = new Set<number>(); // media frames that are there, since everything was forgotten
  #busy = false;
  #work: Promise<void> = Promise.resolve(); // the newest frame's
  #news = false;
  #steppedUs = -Infinity; // the newest refresh of the screen
  #begunUs = -Infinity; // the newest picture
  #drawnView = "";
  #rested = false;
  readonly #spent: ArrayBuffer[] = []; // of patches that the device has
  #newestOrder = 0; // of references that have come
  #ready = false; // there is a renderer, and its shaders are compiled
  #ended = false;

  /** `renderer` may still be on its way: the scene is joined, and its first frame refined, meanwhile. */
  constructor(source: SceneSource, renderer: Promise<Renderer>, view: () => Viewpoint, options: PlayerOptions, events: PlayerEvents) {
    this.#source = source;
    this.#startup = new Startup(this.#holdUs, nowUs());
    this.#view = view;
    this.#events = events;
    this.playing = options.playing;
    this.loop = options.loop;
    this.rate = options.rate;
    this.correct = options.correct;
    this.exactness = options.exactness;
    this.adaptResolution = options.adaptResolution;
    this.#startSeconds = options.startSeconds;
    this.#video = new ReferenceVideo({
      decoded: (reference, coded) => {
        const { camera, knee, kind, error } = reference;
        this.#references.add(reference, coded && { coded, camera, knee, picture: kind === "picture", error });
        this.#news = true;
      },
      broken: (seq) => source.requestKeyframe(seq),
    });
    renderer.then(async (made) => {
      this.#renderer = made;
      await made.prepared;
      this.#ready = true;
    }, () => undefined); // whoever makes it tells why it is not there
  }

  // -------------------------------------------------------------------------------------------------- viewer's wishes

  play(): void {
    if (this.playing) return;
    this.playing = true;
    if (this.#startedUs === null || !this.info) return;
    const last = this.frame >= this.info.frames - 1;
    const sought = this.#awaited !== null && this.#awaited.stalledUs === undefined;
    if (sought && !last) return; // the source would play on meanwhile: it is told when that frame is there
    this.#tell("play", this.frame, nowUs() + (last ? 0 : START_DELAY_US));
    if (last) this.seek(0);
  }

  pause(): void {
    if (!this.playing) return;
    this.playing = false;
    if (this.#startedUs !== null) this.#tell("pause", this.frame, nowUs());
  }

  /** Go to a media frame as soon as what is under way has ended, and the play has begun. */
  seek(frame: number): void {
    if (!this.info) return;
    this.#wanted = Math.max(0, Math.min(Math.round(frame), this.info.frames - 1));
    this.#events.changed();
  }

  setRate(rate: number): void {
    this.rate = rate;
    this.#retell();
  }

  setLoop(on: boolean): void {
    this.loop = on;
    this.#retell();
  }

  /** The page is not seen any more (no frames are asked for), or again. */
  rest(rested: boolean): void {
    if (rested === this.#rested) return;
    this.#rested = rested;
    if (this.#startedUs === null || !this.playing || this.#awaited) return;
    if (rested) this.#tell("pause", this.frame, nowUs());
    else this.#tell("play", this.frame, nowUs() + START_DELAY_US);
  }

  /** The viewer's pinhole is another from now on. */
  reshape(intrinsics: Intrinsics): void {
    this.#source.reshape(intrinsics);
  }

  /** Leave; settles once nothing of this play is drawn any more. */
  async close(): Promise<void> {
    this.#end();
    await this.#work;
  }

  #end(): void {
    if (this.#ended) return;
    this.#ended = true;
    this.#source.close();
  }

  // --------------------------------------------------------------------------------------------------------- in time

  /** Seconds of the clip on display. */
  get seconds(): number {
    return this.info ? (this.#wanted ?? this.frame) / this.info.fps : 0;
  }

  /** Whether a place was gone to that is not there yet. */
  get waiting(): boolean {
    return this.#wanted !== null || this.#awaited !== null || this.#startedUs === null;
  }

  /** Whether a frame is under way. */
  get drawing(): boolean {
    return this.#busy;
  }

  /** Share of the full picture's width that is drawn. */
  get scale(): number {
    return this.#quality.scale;
  }

  /** How many of 1,000 media frames this device displays. */
  get cadencePermille(): number {
    return this.#quality.permille;
  }

  get videoErrors(): number {
    return this.#video.errors;
  }

  /** Take what the source tells. */
  handle(event: SourceEvent): void {
    if (this.#ended) return;
    switch (event.type) {
      case "info":
        this.info = event.info;
        this.frame = this.#startFrame = frameAt(this.#startSeconds, event.info);
        this.#timeline = new Timeline(event.info.fps, event.info.frames, { frame: this.#startFrame });
        this.#quality.periodUs = 1e6 / event.info.fps;
        if (event.info.waits) this.#startup = new Startup((this.#holdUs = 0), nowUs()); // nobody would refine it
        this.#events.info(event.info);
        break;
      case "arrived":
        this.#startup.came(event.atUs, event.tile, event.equipped);
        this.#news = true;
        break;
      case "whole":
        this.#news = true;
        this.#whole.add(event.frame);
        this.#onWhole(event.frame);
        break;
      case "reference":
        this.#newestOrder = event.reference.order;
        this.#video.add(event.reference);
        break;
      case "flushed":
        this.#whole.clear();
        if (this.#awaited?.flushes) this.#awaited.flushes--;
        this.#video.forget();
        this.#references.reset();
        break;
      case "restarted":
        if (event.resumeAt) this.#goOnBy(event.resumeAt);
        break;
      case "notice":
        this.#events.notice(event.message);
        break;
      case "status":
        this.#news ||= event.status.bytesTiles !== this.status?.bytesTiles || this.shown?.update.full === false;
        this.status = event.status;
        this.#events.changed();
        break;
      case "mark":
        this.#references.marked(event.mark);
        this.#news = true;
        break;
      case "error":
        if (event.error.fatal) this.#end();
        this.#events.failed(event.error);
        break;
    }
  }

  /** Before each refresh of the screen. */
  step(): void {
    if (this.#ended || !this.info) return;
    const now = nowUs();
    this.#watchScreen(now);
    this.#samplePose();
    if (this.#busy || this.#rested || !this.#ready) return;
    this.#quality.wish(this.adaptResolution ? SCALES : WHOLE, this.info.moves ? "auto" : "off");
    const next = this.#next(now);
    if (!next) return;
    this.#busy = true;
    this.#work = next()
      .catch((error: unknown) => this.#failed(error))
      .finally(() => (this.#busy = false));
  }

  #failed(error: unknown): void {
    if (this.#ended || this.#renderer?.gpu.lost) return;
    this.#end();
    const message = error instanceof Error ? error.message : String(error);
    this.#events.failed({ code: "frame", message, fatal: true });
  }

  #watchScreen(now: number): void {
    const passed = now - this.#steppedUs;
    this.#steppedUs = now;
    if (passed > SHORTEST_REFRESH_US && passed < LONGEST_REFRESH_US) this.#quality.displayUs += MEMORY * (passed - this.#quality.displayUs);
  }

  #samplePose(): void {
    this.#samples.push({ tUs: nowUs(), pose: this.#view().pose });
    this.#source.sendPoses(this.#samples.slice(-MOST_SAMPLES), this.#quality.permille);
    this.#samples = [];
  }

  #next(now: number): (() => Promise<void>) | null {
    this.#startIfDue(now);
    if (this.#wanted !== null && this.#startedUs !== null) this.#seekNow(this.#wanted, now);
    if (this.#awaited && now >= this.#awaited.untilUs) this.#goOn(now);
    if (this.#startedUs === null || (this.#awaited && !this.shown)) return this.#preview(now) ?? this.#redraw(now);
    if (this.#awaited) return this.#redraw(now);
    const stands = !this.playing || this.info!.frames === 1;
    if (stands) return this.#news ? () => this.#present(this.frame, 0, false) : this.#redraw(now);
    if (this.#dueUs !== null && now >= this.#dueUs) return () => this.#presentDue(now);
    return this.#between(now);
  }

  /** A picture before the play: first of a reference or of the frame itself, then now and then of what more has come. */
  #preview(now: number): (() => Promise<void>) | null {
    this.#references.show(this.frame, this.info!.frames);
    const there = this.#startup.isWhole || this.#references.newest(REFERENCE_AGE);
    const due = this.shown ? this.#news && this.#startup.preview(now) : there;
    return due ? () => this.#present(this.frame, 0, false) : null;
  }

  /** A picture of what moves by itself, or of the frame on display from where the viewer is now. */
  #between(now: number): (() => Promise<void>) | null {
    if (this.#dueUs === null || !this.#quality.fits(now, this.#dueUs)) return null;
    const { stepUs } = this.#quality;
    if (stepUs === undefined || now - this.#begunUs < (1 - NEARLY) * stepUs) return this.#redraw(now);
    const timeline = this.#timeline;
    const tick = timeline.mediaFrame(this.#nextTick) === this.frame ? this.#nextTick : this.#nextTick - 1;
    const share = ((now - timeline.displayUs(tick)) * timeline.fps * timeline.place.rate) / 1e6;
    if (this.frame < timeline.frames - 1 && share > 0 && share < 1) return () => this.#present(this.frame, share, false);
    return this.#redraw(now);
  }

  #redraw(_now: number): (() => Promise<void>) | null {
    const { shown } = this;
    if (!shown || this.#keyOf(this.#view()) === this.#drawnView) return null;
    return () => this.#draw(shown.frame, shown.share, shown.update, performance.now(), false);
  }

  async #presentDue(now: number): Promise<void> {
    const timeline = this.#timeline;
    const { permille } = this.#quality;
    const there = (t: number): boolean => !this.info!.waits || this.#whole.has(timeline.mediaFrame(t)!);
    const tick = newestDue(nextDue(this.#nextTick, this.#endTick, permille), this.#endTick, permille, (t) => timeline.displayUs(t) <= now && there(t));
    const frame = timeline.mediaFrame(tick)!;
    if (!there(tick)) return this.#stall(frame, now);
    this.#nextTick = tick + 1;
    const following = nextDue(tick + 1, this.#endTick, permille);
    this.#dueUs = following > tick ? timeline.displayUs(following) : null;
    this.frame = frame;
    await this.#present(frame, 0, true);
    if (this.playing && this.#wanted === null && !this.#awaited && this.#nextTick >= this.#endTick) this.#atEnd();
  }

  async #present(frame: number, share: number, media: boolean): Promise<void> {
    const begun = performance.now();
    this.#begunUs = nowUs();
    this.#news = false;
    this.#references.show(frame, this.info!.frames);
    const reference = this.#references.newest(REFERENCE_AGE);
    const basis = this.#references.basis(reference, !this.playing);
    const { pose, intrinsics } = this.#view();
    const camera = this.#cameraOf({ pose, intrinsics });
    const speaks = this.correct && reference?.picture ? reference : undefined;
    const spent = this.#spent.splice(0);
    const update = await this.#source.frame({
      frame,
      share,
      ...(spent.length ? { spent } : {}),
      ...(basis === undefined ? {} : { basis }),
      ...(speaks ? { changedSince: changedSince(speaks.reference, camera) } : {}),
    });
    if (this.#ended) return; // the renderer may be another play's by now
    this.#references.marked(update.mark);
    this.#renderer.update(update);
    if (!update.fresh) this.#spent.push(...update.patches.map(({ words }) => words.buffer)); // of all rows they are larger than any
    if (media && update.missed) this.missed++;
    await this.#draw(frame, share, update, begun, media);
  }

  async #draw(frame: number, share: number, update: FrameUpdate, begun: number, media: boolean): Promise<void> {
    const view = this.#view();
    const key = this.#keyOf(view);
    const found = this.correct ? this.#references.newest(REFERENCE_AGE) : undefined;
    const drawn = [];
    const eyes = view.eyes ?? [view];
    for (const [i, eye] of eyes.entries()) {
      const camera = this.#cameraOf(eye);
      const options = this.#frameOptions({ frame, update, camera, display: view.intrinsics }, found?.picture ? found : undefined);
      const times = await this.#renderer.draw(camera, options, view.eyes !== undefined);
      if (this.#ended) return;
      if (view.eyes) this.#events.drew?.(i, eyes.length, camera, this.#renderer.taken());
      drawn.push({ camera, options, times });
    }
    const { camera, options, times } = drawn.at(-1)!;
    this.#drawnView = key;
    this.pictures++;
    const frameMs = performance.now() - begun;
    const gpuMs = drawn.reduce((sum, eye) => sum + eye.times.gpuMs, 0);
    // Before the play everything is decoded for the first time: that says nothing of what the device keeps up with.
    if (this.#startedUs !== null) this.#quality.observe(nowUs(), frameMs * 1000, gpuMs * 1000, media);
    this.shown = { frame, share, camera, reference: found?.reference, update, times, frameMs, atUs: nowUs(), options };
    this.#events.changed();
  }

  #frameOptions(of: { frame: number; update: FrameUpdate; camera: Camera; display: Intrinsics }, found: { reference: Reference; picture: CodedReference | null } | undefined): FrameOptions {
    const { frame, update, camera, display } = of;
    const plain = { exactness: this.exactness, footprint: footprintAt(this.scale), maxShDegree: update.shDegree, display };
    if (!found?.picture) return plain;
    const { changed } = update;
    const weight = this.#weight(found.reference, frame, camera);
    if (!weight) return plain;
    const known = this.#references.beginning && found.reference.frame !== frame; // of its own frame, the comparison tells
    const error = known ? doubted(found.picture.error, update.ownError) : found.picture.error;
    return { ...plain, reference: found.picture, error, stale: 1 - weight, ...(changed ? { changed: cellBoxes(changed.positions, changed.radii, camera) } : {}) };
  }

  /** Of a reference: 1 up to half of the allowed age, then falling to 0; of a difference less beyond its reach. */
  #weight(reference: Reference, frame: number, camera: Camera): number {
    const { focusCentre, focusRadius } = this.info!;
    const fresh = Math.min(1, 2 * (1 - (frame - reference.frame) / (REFERENCE_AGE + 1)));
    if (reference.kind !== "difference") return fresh;
    const away = apart(camera.pose, reference.camera.pose, focusCentre, focusRadius);
    return fresh * validShare(away, reference.reach);
  }

  /** The camera of the next picture, at the pixels that its time allows. */
  #cameraOf({ pose, intrinsics }: Viewed): Camera {
    return { intrinsics: smaller(intrinsics, this.scale), pose, near: this.info!.near };
  }

  #keyOf(view: Viewpoint): string {
    return JSON.stringify([view, this.scale, this.correct, this.exactness]);
  }

  // ------------------------------------------------------------------------------------------------------ state of play

  #onWhole(frame: number): void {
    if (this.#startedUs === null) {
      if (frame >= this.#startFrame && this.#startup.whole(nowUs())) this.#hold();
    } else if (this.#awaited && this.#awaited.flushes <= 0 && this.#arrived(this.#awaited, frame)) this.#goOn(nowUs());
  }

  /** The first frame is there: let the server refine it before it is played. */
  #hold(): void {
    if (this.#holdUs) {
      this.#startup.greeting = this.#newestOrder;
      this.#source.control({ action: "pause", frame: this.#startFrame, atUs: nowUs() });
    }
    if (this.#ready) this.#startIfDue(nowUs());
  }

  /** When the first frame was held for long enough, or is to be held on: fix when it is shown, and tell the source. */
  #startIfDue(now: number): void {
    const { endsUs } = this.#startup;
    const refines = this.playing && this.#wanted === null; // whoever goes elsewhere waits for no detail here
    if (this.#startedUs !== null || endsUs === undefined || (refines && now < endsUs)) return;
    this.#startedUs = now;
    if (this.#startup.greeting) {
      this.#references.reset(this.#startup.greeting);
      this.#news = true; // a still is not drawn anew by itself
    }
    if (this.playing && !this.#rested) this.#tell("play", this.#startFrame, now + START_DELAY_US);
    else this.#tell("pause", this.#startFrame, now);
  }

  #tell(action: PlayState["action"], frame: number, atUs: number): void {
    const [first, end] = this.#source.kept;
    const loop = this.loop && first === 0 && end >= this.info!.frames;
    const state = { action, frame, atUs, rate: this.rate, loop };
    this.#timeline = this.#timeline.controlled(state);
    this.#nextTick = 0;
    this.#endTick = this.#timeline.roundEnd(0);
    this.#dueUs = atUs;
    this.#quality.periodUs = 1e6 / (this.#timeline.fps * this.rate);
    this.#quality.restart();
    this.#source.control(state);
    this.#events.changed();
  }

  /** A server that took over counts from `state`. Where that is no place of the timeline, a later wish is on its way. */
  #goOnBy(state: PlayState): void {
    const timeline = this.#timeline;
    const passed = timeline.firstTick(state.atUs);
    const there = timeline.displayUs(passed) === state.atUs && timeline.mediaFrame(passed) === state.frame;
    if (state.action === "play" && timeline.place.playing && there) {
      this.#nextTick -= passed;
      this.#endTick -= passed;
      this.#timeline = timeline.controlled(state);
    }
    this.#quality.restart();
  }

  /** Speed or loop have changed: from the next frame on. */
  #retell(): void {
    if (this.#startedUs === null || !this.info || !this.playing || this.#awaited) return;
    if (this.#nextTick >= this.#endTick) return; // the end looks at what was told
    this.#tell("rate", this.#timeline.mediaFrame(this.#nextTick)!, Math.max(this.#timeline.displayUs(this.#nextTick), nowUs()));
  }

  #seekNow(frame: number, now: number): void {
    this.#wanted = null;
    const keeps = within(this.#source.kept, frame);
    this.#video.forget();
    this.#references.reset();
    this.frame = frame;
    const flushes = (this.#awaited?.flushes ?? 0) + (keeps ? 0 : 1);
    this.#tell("seek", frame, now);
    if (this.playing) this.#tell("pause", frame, now);
    this.#awaited = { frames: [frame, frame], untilUs: now + SEEK_PATIENCE_US, flushes };
    if (keeps && (!this.info!.waits || this.#whole.has(frame))) this.#goOn(now);
  }

  /** The play has come to `frame`, which has not: it waits until so much is there that it does not wait again at once. */
  #stall(frame: number, now: number): void {
    this.stalls++;
    this.frame = frame;
    const last = Math.min(frame + Math.ceil(REFILL_S * this.info!.fps), this.info!.frames - 1);
    this.#awaited = { frames: [frame, last], untilUs: Infinity, flushes: 0, stalledUs: now };
    this.#events.changed();
  }

  /** Whether what is awaited is there, now that `whole` is; frames of a published folder come in any order. */
  #arrived({ frames: [first, last] }: Awaited, whole: number): boolean {
    if (!this.info!.waits) return whole >= first;
    for (let frame = first; frame <= last; frame++) if (!this.#whole.has(frame)) return false;
    return true;
  }

  /** The frame that was sought is there. */
  #goOn(now: number): void {
    if (this.#awaited?.stalledUs !== undefined) this.stalledMs += (now - this.#awaited.stalledUs) / 1000;
    this.#awaited = null;
    this.#news = true;
    if (this.playing && !this.#rested) this.#tell("play", this.frame, now + START_DELAY_US);
  }

  #atEnd(): void {
    const told = this.#timeline;
    const going = told.place.loop && told.place.rate === this.rate && within(this.#source.kept, 0);
    if (!this.loop) this.pause();
    else if (going && nowUs() - told.displayUs(this.#endTick) <= JUMP_US) {
      this.#endTick = told.roundEnd(this.#endTick);
      this.#dueUs = told.displayUs(nextDue(this.#nextTick, this.#endTick, this.#quality.permille));
    } else this.seek(0);
  }
}

function changedSince(reference: Reference, camera: Camera): { frame: number; basis?: number; camera: Camera; focalPx: number } {
  const { frame, basis, kind } = reference;
  const since = { frame, camera, focalPx: reference.camera.intrinsics.fxPx };
  return kind === "picture" ? since : { ...since, basis };
}

/** The same field of view in fewer pixels. */
function smaller(full: Intrinsics, scale: number): Intrinsics {
  if (scale === 1) return full;
  const [widthPx, heightPx] = [Math.max(1, Math.round(full.widthPx * scale)), Math.max(1, Math.round(full.heightPx * scale))];
  const [x, y] = [widthPx / full.widthPx, heightPx / full.heightPx];
  return { widthPx, heightPx, fxPx: full.fxPx * x, fyPx: full.fyPx * y, cxPx: full.cxPx * x, cyPx: full.cyPx * y };
}

function footprintAt(scale: number): Footprint {
  if (scale === 1) return CLASSIC;
  const half = atHalfResolution(CLASSIC);
  return { dilationPx2: CLASSIC.dilationPx2 * scale * scale, filterPx2: half.filterPx2 };
}
