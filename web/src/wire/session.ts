/**
 * The client's side of a session, sans-IO: as `cags_protocol.sessions.client`, state by state and byte by byte.
 *
 * The owner passes `nowUs`, writes what {@link ClientSession.dataToSend} returns, and calls
 * {@link ClientSession.handleTimer} when {@link ClientSession.nextTimerUs} is reached.
 */
import { EVERY_FRAME } from "./cadence.ts";
import { ProtocolError } from "../bytes/errors.ts";
import { Assembler, BlobAssembler, ReceivedPackets } from "./assembly.ts";
import { DamagedError, decode, encode } from "./encoding.ts";
import { printable } from "./fields.ts";
import * as limits from "./limits.ts";
import {
  type Control, type Fragment, type FrameEnd, type HeldTile, type Hello, type Mark, type Message, type Notice,
  type ReferenceFrame, type Refusal, type Tag, type TileLayers, type Welcome, type WireSample,
} from "./messages.ts";

export type State = "greeting" | "deciding" | "open" | "closed";

/** Why a session ended: bye, refused, timeout, malformed, unexpected or lost; and one line. */
export interface Closed {
  readonly type: "closed";
  readonly code: string;
  readonly reason: string;
}

export type SessionEvent =
  | { readonly type: "welcomed"; readonly welcome: Welcome; readonly nowUs: number }
  | { readonly type: "blob"; readonly name: string; readonly data: Uint8Array<ArrayBuffer> }
  | { readonly type: "tile"; readonly message: TileLayers; readonly payload: Uint8Array }
  | { readonly type: "reference"; readonly message: ReferenceFrame; readonly payload: Uint8Array }
  | { readonly type: "frame_end"; readonly message: FrameEnd; readonly payload: Uint8Array }
  | { readonly type: "mark"; readonly message: Mark }
  | { readonly type: "notice"; readonly notice: Notice }
  | { readonly type: "refused"; readonly refusal: Refusal }
  | Closed;

/** Times after which a session acts by itself, and counts, microseconds. */
export interface SessionSettings {
  readonly handshakeUs: number;
  readonly keepaliveUs: number;
  readonly idleUs: number;
  /** Acknowledgements are at least this far apart, unless `ackPackets` wait for one. */
  readonly ackIntervalUs: number;
  readonly ackPackets: number;
}

export const DEFAULTS: SessionSettings = {
  handshakeUs: 10_000_000, keepaliveUs: 5_000_000, idleUs: 15_000_000, ackIntervalUs: 5_000, ackPackets: 8,
};

/** A server that takes over must answer soon, for there may be another. */
export const RESUMING: SessionSettings = { ...DEFAULTS, handshakeUs: 3_000_000 };

const MAX_PENDING_EVICTIONS = 65536;
const MAX_DAMAGED = 16;
const DATA: ReadonlySet<Tag> = new Set<Tag>(["blob", "tile", "reference", "frame_end", "mark"]);

/** Which message leads where; a message without an entry breaks the protocol. */
const TABLE: Readonly<Record<State, { readonly [T in Tag]?: State }>> = {
  greeting: { refusal: "closed" },
  deciding: { welcome: "open", refusal: "closed", ping: "deciding", pong: "deciding", bye: "closed" },
  open: {
    fragment: "open", abandon: "open", notice: "open", ping: "open", pong: "open", refusal: "closed", bye: "closed",
  },
  closed: {},
};

/** A message that the state of the session does not allow. */
class UnexpectedMessageError extends ProtocolError {}

export class ClientSession {
  /** Packets that failed their CRC. */
  damagedPackets = 0;
  /** What the client holds undecoded; told to the server with each acknowledgement. */
  bufferedBytes = 0;
  /** Round trip of the newest ping that was answered, microseconds. */
  rttUs: number | undefined;
  private now: State = "greeting";
  private readonly settings: SessionSettings;
  private readonly events: SessionEvent[] = [];
  private urgent: Uint8Array<ArrayBuffer>[] = [];
  private readonly startedUs: number;
  private heardUs: number;
  private saidUs: number;
  private receivedUs: number;
  private ackedUs: number;
  private unacked = 0;
  private damaged = 0;
  private readonly packets = new ReceivedPackets();
  private readonly assembler = new Assembler();
  private readonly blobs = new BlobAssembler();
  private readonly evicted = new Map<string, HeldTile>();

  constructor(nowUs: number, settings: SessionSettings = DEFAULTS) {
    this.settings = settings;
    this.startedUs = this.heardUs = this.saidUs = this.receivedUs = this.ackedUs = nowUs;
  }

  get state(): State {
    return this.now;
  }

  /** Whether the session is over. What {@link dataToSend} still returns should be written before hanging up. */
  get closed(): boolean {
    return this.now === "closed";
  }

  /** Bytes of messages that are not complete yet. */
  get partialBytes(): number {
    return this.assembler.partialBytes;
  }

  /** The next event, oldest first. */
  nextEvent(): SessionEvent | undefined {
    return this.events.shift();
  }

  // ------------------------------------------------------------------------------------------------------------ sending

  /** Say hello; once, first. */
  hello(hello: Hello, nowUs: number): void {
    if (this.now !== "greeting") throw new ProtocolError(`hello is possible once, not in state ${this.now}`);
    this.now = "deciding";
    this.say(hello, nowUs);
  }

  /** Send poses, oldest first, and the share of media frames that is displayed; nothing unless the session is open. */
  sendPoses(samples: readonly WireSample[], nowUs: number, cadencePermille = EVERY_FRAME): void {
    if (this.now !== "open") return;
    for (let start = 0; start < samples.length; start += limits.MAX_POSE_SAMPLES) {
      const some = samples.slice(start, start + limits.MAX_POSE_SAMPLES);
      this.say({ type: "poses", samples: some, cadence_permille: cadencePermille }, nowUs);
    }
  }

  /** Play, pause, seek or change the rate; nothing unless the session is open. */
  control(control: Control, nowUs: number): void {
    if (this.now === "open") this.say(control, nowUs);
  }

  /** Ask for an IDR picture; nothing unless the session is open. */
  requestKeyframe(referenceSeq: number, nowUs: number): void {
    if (this.now === "open") this.say({ type: "keyframe", reference_seq: referenceSeq }, nowUs);
  }

  /** Ask for a round trip; nothing unless the session is open. */
  ping(nowUs: number): void {
    if (this.now === "open") this.say({ type: "ping", t_us: nowUs }, nowUs);
  }

  /** Tell the server, with the next acknowledgements, what the store dropped (`lods`: what is left). */
  reportEvictions(tiles: Iterable<HeldTile>): void {
    for (const tile of tiles) {
      this.evicted.set(`${tile.frame}/${tile.tile}`, tile);
      if (this.evicted.size > MAX_PENDING_EVICTIONS) this.evicted.delete(this.evicted.keys().next().value!);
    }
  }

  /** Messages to write now, in order. */
  dataToSend(nowUs: number): Uint8Array<ArrayBuffer>[] {
    const due = this.ackDueUs();
    if (this.now === "open" && due !== undefined && nowUs >= due) this.acknowledge(nowUs);
    const out = this.urgent;
    this.urgent = [];
    return out;
  }

  /** When {@link handleTimer} or {@link dataToSend} wants to be called; undefined: never. */
  nextTimerUs(): number | undefined {
    if (this.closed) return undefined;
    const s = this.settings;
    const timer = this.now === "open"
      ? Math.min(this.heardUs + s.idleUs, this.saidUs + s.keepaliveUs)
      : this.startedUs + s.handshakeUs;
    return Math.min(timer, this.ackDueUs() ?? Infinity);
  }

  /** Do what is due. */
  handleTimer(nowUs: number): void {
    if (this.closed) return;
    const s = this.settings;
    if (this.now !== "open") {
      if (nowUs >= this.startedUs + s.handshakeUs) this.bye(`no handshake within ${plain(s.handshakeUs / 1e6)} s`, nowUs);
    } else if (nowUs >= this.heardUs + s.idleUs) {
      this.bye(`nothing heard for ${plain(s.idleUs / 1e6)} s`, nowUs);
    } else if (nowUs >= this.saidUs + s.keepaliveUs) {
      this.say({ type: "ping", t_us: nowUs }, nowUs);
    }
  }

  /** Leave; the goodbye is in {@link dataToSend}. */
  bye(reason: string, nowUs: number): void {
    if (this.closed) return;
    this.say({ type: "bye", reason }, nowUs);
    this.close("bye", reason);
  }

  /** The transport ended without a goodbye. */
  connectionLost(reason: string): void {
    this.close("lost", reason);
  }

  private ackDueUs(): number | undefined {
    if (this.unacked >= this.settings.ackPackets) return this.receivedUs;
    return this.unacked || this.evicted.size ? this.ackedUs + this.settings.ackIntervalUs : undefined;
  }

  private acknowledge(nowUs: number): void {
    const some = [...this.evicted].slice(0, limits.MAX_EVICTED_TILES);
    for (const [key] of some) this.evicted.delete(key);
    const ack: Message = {
      type: "ack",
      ranges: this.packets.ranges,
      received_us: this.receivedUs,
      delay_us: Math.max(nowUs - this.receivedUs, 0),
      buffered_bytes: this.bufferedBytes,
      evicted: some.map(([, tile]) => tile),
    };
    this.say(ack, nowUs);
    this.unacked = 0;
    this.ackedUs = nowUs;
  }

  private say(message: Message, nowUs: number): void {
    this.urgent.push(encode(message));
    this.saidUs = nowUs;
  }

  // ---------------------------------------------------------------------------------------------------------- receiving

  /** Take one message of the server. Never raises for what a peer sends: a breach ends the session with an event. */
  receive(data: Uint8Array, nowUs: number): void {
    if (this.closed) return;
    try {
      const { message, payload } = decode(data);
      this.heardUs = nowUs;
      this.step(message, payload, nowUs);
    } catch (error) {
      if (!(error instanceof ProtocolError)) throw error;
      this.onBreach(error, nowUs);
    }
  }

  private step(message: Message, payload: Uint8Array, nowUs: number): void {
    const state = TABLE[this.now][message.type];
    if (state === undefined) {
      throw new UnexpectedMessageError(`${message.type} must not come in state ${this.now}`);
    }
    if (message.type === "ping") this.say({ type: "pong", t_us: message.t_us }, nowUs);
    else if (message.type === "bye") this.close("bye", message.reason);
    else if (message.type === "pong") this.rttUs = Math.max(nowUs - Number(message.t_us), 0);
    else {
      this.now = state === "closed" ? "open" : state;
      this.onMessage(message, payload, nowUs);
    }
  }

  private onMessage(message: Message, payload: Uint8Array, nowUs: number): void {
    this.damaged = 0;
    switch (message.type) {
      case "fragment": return this.onFragment(message, payload, nowUs);
      case "abandon": return message.idents.forEach((ident) => this.assembler.abandon(ident));
      case "welcome": return void this.events.push({ type: "welcomed", welcome: message, nowUs });
      case "notice": return void this.events.push({ type: "notice", notice: message });
      case "refusal":
        this.events.push({ type: "refused", refusal: message });
        return this.close("refused", `${message.code}: ${message.message}`);
    }
  }

  private onFragment(fragment: Fragment, chunk: Uint8Array, nowUs: number): void {
    if (!this.packets.add(fragment.seq)) return;
    this.unacked += 1;
    this.receivedUs = nowUs;
    const data = this.assembler.add(fragment, chunk);
    if (data === undefined) return;
    const { message, payload } = decodedWhole(data, fragment.ident);
    if (!DATA.has(message.type)) throw new ProtocolError(`${message.type} must not come in fragments`);
    this.onData(message, payload);
  }

  private onData(message: Message, payload: Uint8Array): void {
    switch (message.type) {
      case "tile": return void this.events.push({ type: "tile", message, payload });
      case "reference": return void this.events.push({ type: "reference", message, payload });
      case "frame_end": return void this.events.push({ type: "frame_end", message, payload });
      case "mark": return void this.events.push({ type: "mark", message });
      case "blob": {
        const data = this.blobs.add(message, payload);
        if (data !== undefined) this.events.push({ type: "blob", name: message.name, data });
      }
    }
  }

  /** A damaged packet is as good as lost: the gap in the acknowledgements tells the server. A breach ends all. */
  private onBreach(error: ProtocolError, nowUs: number): void {
    if (error instanceof DamagedError && this.now === "open") {
      this.damaged += 1;
      this.damagedPackets += 1;
      if (this.damaged <= MAX_DAMAGED) return;
    }
    if (this.now !== "greeting") this.say({ type: "bye", reason: printable(error.message, limits.MAX_TEXT_BYTES) }, nowUs);
    this.close(error instanceof UnexpectedMessageError ? "unexpected" : "malformed", error.message);
  }

  private close(code: string, reason: string): void {
    if (this.closed) return;
    this.now = "closed";
    this.events.push({ type: "closed", code, reason });
  }
}

function decodedWhole(data: Uint8Array, ident: number): ReturnType<typeof decode> {
  try {
    return decode(data);
  } catch (error) {
    if (!(error instanceof DamagedError)) throw error;
    throw new ProtocolError(`message ${ident}: ${error.message}`); // every packet was whole: the server built it so
  }
}

/** A number as Python's `:g` writes it, for the whole seconds that timers have. */
function plain(value: number): string {
  return String(Number(value.toPrecision(6)));
}
