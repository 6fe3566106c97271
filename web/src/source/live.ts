/**
 * A scene from a server, over a WebSocket: joins, decodes, acknowledges, and comes back after a loss with an inventory of
 * what is held, so that nothing of it is sent again. The counterpart of `cags_client.playback.player`, without the display.
 */
import { BundleError, DecodeError } from "../bytes/errors.ts";
import { readManifest, sceneInfo } from "../decode/manifest.ts";
import {
  type Camera, type ConnectOptions, type FrameRequest, type FrameUpdate, type Intrinsics, type FrameRange, type LinkState, NO_FRAMES, nowUs, type PlayState,
  type PoseSample, type Reference, type SceneSource, type SourceEvent, within,
} from "../seam.ts";
import { arrivalOf } from "../store/tileStore.ts";
import { splitLayers } from "../wire/encoding.ts";
import { packInventory, unpackInventory } from "../wire/inventory.ts";
import { PROTOCOL_VERSION, SUBPROTOCOL } from "../wire/limits.ts";
import type { Control, Hello, Refusal, Welcome } from "../wire/messages.ts";
import { ClientSession, DEFAULTS, RESUMING, type SessionEvent } from "../wire/session.ts";
import { Timeline } from "../wire/timeline.ts";
import { BASE_CODEBOOKS_BLOB, CODEBOOKS_BLOB } from "../wire/assembly.ts";
import { DecodeQueue, type DataEvent, MAX_UNDECODED_BYTES } from "./decodeQueue.ts";
import { Reconnect } from "./reconnect.ts";
import { type Decoders, memoryMb, SceneStore, tooLarge } from "./scene.ts";
import { Meter } from "./status.ts";

/** Refusals that may be gone a moment later; another attempt would only meet the others again. */
const PASSING_REFUSALS = new Set(["full", "timeout", "internal"]);
const KNOWN_REFUSALS = new Set(["version", "token", "full", "malformed", "unexpected", "quota", "timeout", "internal"]);
const FATAL_ENDS = new Set(["malformed", "unexpected"]);
const KEYFRAME_RETRY_US = 250_000;
/** From going on after a loss to the frame that is then displayed. */
const RESUME_DELAY_US = 250_000;
const STATUS_EVERY_US = 250_000;
const PING_EVERY_US = 1_000_000;
const CONNECT_TIMEOUT_US = 10_000_000;
const AGENT = "cags-web";

/** The part of a WebSocket that is used, so that tests bring their own. */
export interface Socket {
  binaryType: string;
  onopen: ((event: never) => void) | null;
  onmessage: ((event: { data: unknown }) => void) | null;
  onclose: ((event: { reason: string; code: number }) => void) | null;
  onerror: ((event: never) => void) | null;
  send(data: Uint8Array<ArrayBuffer>): void;
  close(): void;
}

export type OpenSocket = (url: string, protocol: string) => Socket;

const openWebSocket: OpenSocket = (url, protocol) => new WebSocket(url, protocol) as unknown as Socket;

/** A control with what the page took for granted when it said so. */
export interface KeepingState extends PlayState {
  /** Whether the page expects what is held to stay; undefined: whatever the store says. */
  readonly keeps?: boolean;
}

export class LiveSource implements SceneSource {
  private readonly decoders: Decoders;
  private readonly openSocket: OpenSocket;
  private url = "";
  private options!: ConnectOptions;
  private listen: (event: SourceEvent) => void = () => {};
  private session = new ClientSession(0);
  private socket: Socket | undefined;
  private socketSinceUs = 0;
  private scene: SceneStore | undefined;
  private welcome: Welcome | undefined;
  private codebooks: Uint8Array | undefined;
  private readonly queue = new DecodeQueue();
  private unread: Uint8Array[] = []; // messages that came while too much was undecoded
  private reconnect!: Reconnect;
  private readonly meter = new Meter();
  private why = "the connection was lost";
  private ended = false;
  private connection = 0;
  private order = 0;
  private markedBefore = 0; // newest mark of connections before this one
  private restartsDue = 0; // jumps by which everything was forgotten, and of which the server has not heard
  private forgotten: number | undefined; // frame of the last such jump since the Hello that has no answer yet
  private flushedBy: DataEvent | undefined; // the mark that the page has been told of already
  private playState: KeepingState | undefined;
  private resumeAt: Control | undefined;
  private resumeOf: KeepingState | undefined; // what the page had said by then
  private pose: PoseSample["pose"];
  private asked = { seq: -1, atUs: -Infinity };
  private timer: ReturnType<typeof setTimeout> | undefined;
  private timerUs = Infinity;
  private pingedUs = 0;
  private decoding = false;
  private said: Intrinsics | undefined; // to the server
  private rejoining = false; // by our own wish, which is no trouble to tell of
  private came: "nothing" | "part" | "tile" = "nothing"; // the most of it, since that was told last

  constructor(decoders: Decoders, openSocket: OpenSocket = openWebSocket) {
    this.decoders = decoders;
    this.openSocket = openSocket;
    this.pose = { position: [0, 0, 0], rotation: [1, 0, 0, 0] };
  }

  // --------------------------------------------------------------------------------------------------------- SceneSource

  connect(url: string, options: ConnectOptions, listen: (event: SourceEvent) => void): void {
    this.url = url;
    this.options = options;
    this.listen = listen;
    this.pose = options.pose;
    this.reconnect = new Reconnect((options.reconnectS ?? Infinity) * 1e6);
    this.open();
    this.wake();
  }

  control(state: KeepingState): void {
    const now = nowUs();
    const kept = within(this.kept, state.frame) && state.keeps !== false;
    if (state.action === "seek" && !kept) this.forget(state.frame);
    else if (state.action === "seek" && this.scene) this.scene.shownFrame = state.frame;
    this.playState = state;
    this.session.control(controlOf(state, kept), now);
    this.wake();
  }

  get kept(): FrameRange {
    return this.scene?.kept ?? NO_FRAMES;
  }

  sendPoses(samples: readonly PoseSample[], cadencePermille?: number): void {
    this.pose = samples.at(-1)?.pose ?? this.pose;
    const given = samples.map(({ tUs, pose }) => ({ t_us: tUs, pose }));
    this.session.sendPoses(given, nowUs(), cadencePermille);
    this.wake();
  }

  requestKeyframe(seq: number): void {
    const now = nowUs();
    if (now - this.asked.atUs < KEYFRAME_RETRY_US) return;
    this.asked = { seq, atUs: now };
    this.session.requestKeyframe(seq, now);
    this.wake();
  }

  /** A server learns a display's shape by a Hello alone: it is joined anew, with what is held. */
  reshape(intrinsics: Intrinsics): void {
    this.options = { ...this.options, intrinsics };
    if (!this.ended && this.session.state === "open" && this.reconnect.possible) this.rejoin();
  }

  async frame(request: FrameRequest): Promise<FrameUpdate> {
    if (!this.scene) throw new Error("no frame before the scene is known");
    const view: Camera = { intrinsics: this.options.intrinsics, pose: this.pose, near: this.scene.manifest.near };
    return this.scene.frame(request, view);
  }

  close(): void {
    if (this.ended) return;
    this.session.bye("", nowUs());
    this.flushOut();
    this.end();
  }

  // ---------------------------------------------------------------------------------------------------------- connection

  private open(): void {
    const resuming = this.scene !== undefined;
    const now = nowUs();
    this.socketSinceUs = now;
    const socket = this.openSocket(this.url, SUBPROTOCOL);
    this.socket = socket;
    this.session = new ClientSession(now, resuming ? RESUMING : DEFAULTS);
    this.unread = [];
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.socket === socket && this.opened();
    socket.onmessage = (event) => this.socket === socket && this.onMessage(event.data);
    socket.onclose = (event) => this.socket === socket && this.lost(event.reason || `closed with code ${event.code}`);
    socket.onerror = null;
  }

  private opened(): void {
    const now = nowUs();
    this.connection += 1;
    for (; this.restartsDue > 0; this.restartsDue--) this.listen({ type: "flushed" });
    this.forgotten = undefined;
    this.resumeAt = this.stateOfPlay(now);
    this.resumeOf = this.playState;
    const hello = this.hello(this.resumeAt?.frame ?? this.playState?.frame ?? this.options.startFrame ?? 0);
    if (this.scene) this.queue.add({ type: "restarted", inventory: unpackInventory(hello.inventory) });
    this.said = hello.intrinsics;
    this.session.hello(hello, now);
    this.wake();
  }

  /** With what is held, once there is a decoder for it. */
  private hello(frame: number): Hello {
    const { scene, welcome, options } = this;
    const resumes = scene && this.codebooks && welcome;
    return {
      type: "hello",
      version: PROTOCOL_VERSION,
      intrinsics: options.intrinsics,
      pose: this.pose,
      near: scene?.manifest.near ?? 0.2,
      start_frame: frame,
      token: options.token ?? "",
      agent: AGENT,
      resume: resumes ? welcome.session : "",
      references: options.references ?? "any",
      chroma: options.chroma ?? "yuv444p",
      inventory: resumes ? packInventory(this.queue.held(scene.held())) : new Uint8Array(0),
    };
  }

  /** Where the play will stand once a server has taken the session over; undefined before it has begun. */
  private stateOfPlay(now: number): Control | undefined {
    const state = this.playState;
    if (!state || !this.scene) return undefined;
    const kept = (frame: number): boolean => within(this.kept, frame);
    if (state.action === "pause" || state.action === "seek") {
      return controlOf({ ...state, action: "pause", atUs: now }, kept(state.frame));
    }
    const { fps, frames } = this.scene.manifest;
    const timeline = new Timeline(fps, frames).controlled({ ...state, action: "play" });
    const soon = Math.max(timeline.firstTick(now + RESUME_DELAY_US), 0);
    const tick = timeline.mediaFrame(soon) === null ? timeline.roundEnd(0) - 1 : soon;
    const going = { ...state, action: "play" as const, frame: timeline.mediaFrame(tick)!, atUs: timeline.displayUs(tick) };
    this.playState = going;
    return controlOf(going, kept(going.frame));
  }

  private lost(reason: string): void {
    if (this.ended) return;
    this.drop();
    this.session.connectionLost(reason);
    this.pump();
    this.wake();
  }

  private rejoin(): void {
    const now = nowUs();
    this.rejoining = true;
    this.session.bye("", now);
    while (this.session.nextEvent()); // its end is known
    this.flushOut();
    this.drop();
    this.reconnect.lost(now);
    this.wake();
  }

  private drop(): void {
    const { socket } = this;
    this.socket = undefined;
    if (!socket) return;
    socket.onclose = socket.onmessage = socket.onopen = null;
    socket.close();
  }

  private end(): void {
    this.ended = true;
    clearTimeout(this.timer);
    this.drop();
    this.tellStatus();
    this.scene?.dispose();
    this.scene = undefined;
  }

  private fail(code: string, message: string): void {
    if (this.ended) return;
    this.listen({ type: "error", error: { code, message, fatal: true } });
    this.end();
  }

  // ------------------------------------------------------------------------------------------------------------- session

  private onMessage(data: unknown): void {
    if (!(data instanceof ArrayBuffer)) return this.lost("the server sent text");
    const bytes = new Uint8Array(data);
    this.meter.received(bytes.length, nowUs());
    if (this.queue.undecodedBytes > MAX_UNDECODED_BYTES) this.unread.push(bytes);
    else this.take(bytes);
    this.wake();
  }

  private take(bytes: Uint8Array): void {
    const now = nowUs();
    this.session.receive(bytes, now);
    if (this.session.partialBytes) this.partCame();
    this.pump();
    this.tellArrived(now);
    if (!this.scene?.ready && this.queue.undecodedBytes > MAX_UNDECODED_BYTES) {
      this.fail("codebooks", "the server sends tiles without the codebooks that they need");
    }
  }

  /** While the play is held, how long depends on what still arrives. */
  private tellArrived(atUs: number): void {
    const held = this.playState === undefined || this.playState.action === "pause";
    if (this.came !== "nothing" && held && !this.ended) {
      this.listen({ type: "arrived", atUs, tile: this.came === "tile", equipped: this.codebooks !== undefined });
    }
    this.came = "nothing";
  }

  private partCame(): void {
    if (this.came === "nothing") this.came = "part";
  }

  private pump(): void {
    for (let event; (event = this.session.nextEvent()); ) this.onEvent(event);
  }

  private onEvent(event: SessionEvent): void {
    switch (event.type) {
      case "welcomed": return this.onWelcome(event.welcome);
      case "blob": return this.onBlob(event.name, event.data);
      case "tile":
        this.meter.bytesTiles += event.payload.length;
        this.came = "tile";
        return this.keep(event);
      case "reference":
        this.meter.bytesReference += event.payload.length;
        return this.keep(event);
      case "frame_end": return this.keep(event);
      case "mark":
        if (event.message.restart && this.restartsDue > 0) {
          this.restartsDue--;
          this.flushedBy = event;
          this.listen({ type: "flushed" });
        }
        return this.keep(event);
      case "notice": return this.listen({ type: "notice", code: event.notice.code, message: event.notice.message });
      case "refused": return this.onRefused(event.refusal);
      case "closed": return this.onClosed(event.code, event.reason);
    }
  }

  /** Media, unless it was sent before the server heard of a jump by which everything was forgotten. */
  private keep(event: DataEvent): void {
    if (!this.restartsDue) this.queue.add(event);
  }

  private onWelcome(welcome: Welcome): void {
    if (this.welcome && !sameBytes(this.welcome.info, welcome.info)) {
      return this.fail("scene", "the server streams another scene now; reload the page");
    }
    if (this.playState !== this.resumeOf) this.resumeAt = this.stateOfPlay(nowUs());
    const returned = this.reconnect.away;
    this.reconnect.restored();
    this.meter.reconnects += returned && !this.rejoining ? 1 : 0;
    this.rejoining = false;
    this.welcome = welcome;
    if (!this.scene && !this.makeScene(welcome)) return;
    if (returned && this.connection > 1) {
      if (!welcome.resumed) this.queue.add({ type: "restarted", inventory: [] }); // everything comes again
      this.tellRestarted();
    }
    if (this.forgotten !== undefined && welcome.resumed) { // the Hello spoke of more than is held
      this.session.control({ type: "control", action: "seek", frame: this.forgotten, at_us: nowUs(), rate: 1, loop: false, keeps: false }, nowUs());
      this.restartsDue += 1;
    }
    this.forgotten = undefined;
    if (this.resumeAt) this.session.control(this.resumeAt, nowUs());
    this.resumeAt = undefined;
    if (this.said !== this.options.intrinsics) this.reshape(this.options.intrinsics); // it changed while this was on its way
  }

  private tellRestarted(): void {
    const { resumeAt: at, connection } = this;
    if (!at) return this.listen({ type: "restarted", connection });
    const resumeAt: PlayState = { action: at.action, frame: at.frame, atUs: at.at_us, rate: at.rate, loop: at.loop };
    this.listen({ type: "restarted", connection, resumeAt });
  }

  /** Make the store once the manifest is there; the codebooks follow. */
  private makeScene(welcome: Welcome): boolean {
    try {
      const manifest = readManifest(welcome.info);
      const large = tooLarge(manifest, this.options.maxSplats ?? 4_000_000, this.options.maxMemoryMb ?? memoryMb());
      if (large) throw new BundleError(large);
      this.scene = new SceneStore(manifest, this.decoders, this.options.startFrame ?? 0);
      this.listen({ type: "info", info: sceneInfo(manifest, false) });
      return true;
    } catch (error) {
      if (!(error instanceof BundleError)) throw error;
      this.fail("manifest", error.message);
      return false;
    }
  }

  private onBlob(name: string, data: Uint8Array): void {
    const { scene } = this;
    this.meter.bytesOther += data.length;
    if ((name !== CODEBOOKS_BLOB && name !== BASE_CODEBOOKS_BLOB) || !scene) return;
    const whole = name === CODEBOOKS_BLOB;
    if (whole && this.codebooks && !sameBytes(this.codebooks, data)) {
      return this.fail("codebooks", "the server streams another encoding of the scene now; reload the page");
    }
    if (whole) this.codebooks = data;
    this.partCame();
    try {
      if (whole) scene.codebooks(data);
      else scene.baseCodebooks(data);
    } catch (error) {
      if (!(error instanceof BundleError || error instanceof DecodeError)) throw error;
      this.fail("codebooks", error.message);
    }
  }

  private onRefused(refusal: Refusal): void {
    this.why = `the server refused${refusal.field ? ` (${refusal.field})` : ""}: ${refusal.message}`;
    if (KNOWN_REFUSALS.has(refusal.code) && !PASSING_REFUSALS.has(refusal.code)) this.fail(refusal.code, this.why);
  }

  private onClosed(code: string, reason: string): void {
    if (this.ended) return;
    if (code === "lost") this.why = `the connection was lost (${reason})`;
    else if (code !== "refused") this.why = `the session ended early (${code}: ${reason})`;
    this.flushOut();
    this.drop();
    this.rejoining = false;
    if (FATAL_ENDS.has(code) || !this.reconnect.possible) return this.fail(code, this.why);
    if (!this.reconnect.away) this.listen({ type: "error", error: { code, message: this.why, fatal: false } });
    this.reconnect.lost(nowUs());
    this.wake();
  }

  // ------------------------------------------------------------------------------------------------------------- in time

  /** Something has happened: write, decode, and look what is due. */
  private wake(): void {
    if (this.ended) return;
    this.flushOut();
    this.startDecoding();
    this.schedule();
  }

  private flushOut(): void {
    this.session.bufferedBytes = this.queue.undecodedBytes;
    for (const data of this.session.dataToSend(nowUs())) this.socket?.send(data);
  }

  private schedule(): void {
    const socketUs = this.socket && this.session.state === "greeting" ? this.socketSinceUs + CONNECT_TIMEOUT_US : Infinity;
    const times = [this.session.nextTimerUs(), this.reconnect.nextTimerUs(), socketUs, this.meter.toldUs + STATUS_EVERY_US];
    const due = Math.min(...times.filter((t) => t !== undefined));
    if (this.timer !== undefined && this.timerUs <= due) return;
    clearTimeout(this.timer);
    this.timerUs = due;
    this.timer = setTimeout(() => this.onTimer(), Math.max((due - nowUs()) / 1000, 0));
  }

  private onTimer(): void {
    this.timer = undefined;
    const now = nowUs();
    const late = this.session.state === "greeting" && now >= this.socketSinceUs + CONNECT_TIMEOUT_US;
    if (this.socket && late) this.lost("the server does not answer");
    if (this.session.state !== "greeting") this.session.handleTimer(now);
    this.pump();
    if (this.ended) return;
    if (this.reconnect.expired(now)) return this.fail("lost", this.why);
    if (this.reconnect.begin(now)) this.open();
    if (now >= this.pingedUs + PING_EVERY_US) {
      this.pingedUs = now;
      this.session.ping(now);
    }
    if (now >= this.meter.toldUs + STATUS_EVERY_US) this.tellStatus();
    this.wake();
  }

  private tellStatus(): void {
    const now = nowUs();
    const { session, reconnect, meter } = this;
    const link: LinkState = this.ended ? "ended" : this.rejoining ? "connecting" : reconnect?.away ? "away" : session.state === "open" ? "open" : "connecting";
    const figures = meter.figures(now);
    this.listen({
      type: "status",
      status: {
        atUs: now, link, attempts: reconnect?.attempts ?? 0, ...figures,
        ...(session.rttUs === undefined ? {} : { rttMs: session.rttUs / 1000 }),
        undecodedBytes: this.queue.undecodedBytes, damagedPackets: session.damagedPackets,
        framesAhead: this.scene?.store.ahead(this.scene.shownFrame) ?? 0,
        references: (this.options?.references ?? "any") !== "none",
      },
    });
  }

  // ------------------------------------------------------------------------------------------------------------ decoding

  private startDecoding(): void {
    if (this.decoding || !this.scene || !this.queue.length) return;
    this.decoding = true;
    soon(() => {
      this.decoding = false;
      if (!this.ended) this.decodeSome();
    });
  }

  private decodeSome(): void {
    const { scene } = this;
    if (!scene) return;
    const batch = this.queue.take(scene.ready);
    if (!batch.length) return;
    const tiles = batch.filter((event) => event.type === "tile").map(({ message, payload }) =>
      arrivalOf(message.frame, message.tile, message.from_lod, splitLayers(message.sizes, payload)));
    if (tiles.length) this.meter.decodeErrors += scene.add(tiles).length;
    for (const event of batch) this.decodeOther(scene, event);
    this.session.reportEvictions(scene.store.takeDropped());
    while (this.unread.length && this.queue.undecodedBytes <= MAX_UNDECODED_BYTES) this.take(this.unread.shift()!);
    this.wake();
  }

  private decodeOther(scene: SceneStore, event: DataEvent): void {
    try {
      if (event.type === "reference") this.tellReference(event);
      else if (event.type === "frame_end") {
        scene.end(event.message.frame, event.payload);
        this.listen({ type: "whole", frame: event.message.frame, mark: scene.mark });
      } else if (event.type === "mark") {
        if (event.message.restart) {
          scene.store.reset(scene.shownFrame);
          if (event !== this.flushedBy) this.listen({ type: "flushed" }); // the server's own wish
        }
        this.meter.decodeErrors += scene.marked(this.markedBefore + event.message.number).length;
        this.listen({ type: "mark", mark: scene.mark });
      } else if (event.type === "restarted") {
        this.markedBefore = scene.mark;
        scene.store.restarted(event.inventory);
      }
    } catch (error) {
      if (!(error instanceof DecodeError)) throw error;
      this.meter.decodeErrors += 1;
    }
  }

  private tellReference({ message, payload }: Extract<DataEvent, { type: "reference" }>): void {
    if (message.kind === "nothing" && payload.length) {
      throw new DecodeError(`reference of frame ${message.frame} says nothing in ${payload.length} bytes`);
    }
    this.order += 1;
    const { frame, seq, idr, kind, knee, error, reach, pose, intrinsics } = message;
    const camera: Camera = { intrinsics, pose, near: this.scene!.manifest.near };
    const reference: Reference = {
      frame, seq, order: this.order, connection: this.connection, idr, kind, camera,
      basis: this.markedBefore + message.basis, knee, error, reach, data: payload.slice(),
    };
    this.listen({ type: "reference", reference });
  }

  /** The viewer jumped where nothing is held: what comes until the server has heard of it is of the time before. */
  private forget(frame: number): void {
    this.queue.clear();
    this.scene?.reset(frame);
    if (this.session.state === "open") this.restartsDue += 1;
    else {
      this.forgotten = frame;
      this.listen({ type: "flushed" });
    }
  }
}

function controlOf(state: PlayState, keeps: boolean): Control {
  const { action, frame, atUs, rate = 1, loop = false } = state;
  return { type: "control", action, frame, at_us: atUs, rate, loop, keeps };
}

function sameBytes(a: Uint8Array, b: Uint8Array): boolean {
  return a.length === b.length && a.every((byte, i) => byte === b[i]);
}

/** Run `work` after what waits in the event loop, without the clamp of timers. */
function soon(work: () => void): void {
  const { port1, port2 } = new MessageChannel();
  port1.onmessage = () => {
    port1.close();
    work();
  };
  port2.postMessage(0);
}
