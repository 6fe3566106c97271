/** The messages of the wire protocol, as `cags_protocol.wire.messages`; fields have the names that they travel by. */
import { EVERY_FRAME, LEAST_PERMILLE } from "./cadence.ts";
import type { Chroma, Intrinsics, Pose, ReferenceKind, ReferencesWanted } from "../seam.ts";
import { choice, flag, integer, intrinsics, type Kind, listOf, pose, real, record, text, wide } from "./fields.ts";
import * as limits from "./limits.ts";

export interface HeldTile {
  readonly frame: number;
  readonly tile: number;
  /** Levels 0 .. lods - 1 are held. */
  readonly lods: number;
}

export interface SeqRange {
  readonly first: number;
  readonly last: number;
}

export interface WireSample {
  readonly t_us: number;
  readonly pose: Pose;
}

export interface Hello {
  readonly type: "hello";
  readonly version: number;
  readonly intrinsics: Intrinsics;
  readonly pose: Pose;
  readonly near: number;
  readonly start_frame: number;
  readonly token: string;
  readonly agent: string;
  readonly resume: string;
  readonly references: ReferencesWanted;
  readonly chroma: Chroma;
  /** Payload: what is held of an earlier session. */
  readonly inventory: Uint8Array;
}

export interface PoseBatch {
  readonly type: "poses";
  readonly samples: readonly WireSample[];
  readonly cadence_permille: number;
}

export interface Ack {
  readonly type: "ack";
  readonly ranges: readonly SeqRange[];
  readonly received_us: number;
  readonly delay_us: number;
  readonly buffered_bytes: number;
  readonly evicted: readonly HeldTile[];
}

export interface Control {
  readonly type: "control";
  readonly action: "play" | "pause" | "seek" | "rate";
  readonly frame: number;
  readonly at_us: number;
  readonly rate: number;
  readonly loop: boolean;
  readonly keeps: boolean;
}

export interface KeyframeRequest {
  readonly type: "keyframe";
  readonly reference_seq: number;
}

export interface Bye {
  readonly type: "bye";
  readonly reason: string;
}

export interface Ping {
  readonly type: "ping";
  readonly t_us: number | bigint;
}

export interface Pong {
  readonly type: "pong";
  readonly t_us: number | bigint;
}

export interface Welcome {
  readonly type: "welcome";
  readonly session: string;
  readonly fps: number;
  readonly frames: number;
  readonly resumed: boolean;
  /** Payload: the public part of the manifest, JSON. */
  readonly info: Uint8Array;
}

export interface Blob {
  readonly type: "blob";
  readonly name: string;
  readonly offset: number;
  readonly total: number;
}

export interface TileLayers {
  readonly type: "tile";
  readonly frame: number;
  readonly tile: number;
  readonly from_lod: number;
  readonly to_lod: number;
  readonly sizes: readonly number[];
  /** Of messages of versions before 4. */
  readonly crcs: readonly number[];
}

export interface ReferenceFrame {
  readonly type: "reference";
  readonly frame: number;
  readonly seq: number;
  readonly pose: Pose;
  readonly intrinsics: Intrinsics;
  readonly idr: boolean;
  readonly kind: ReferenceKind;
  readonly basis: number;
  readonly knee: number;
  readonly error: number;
  readonly reach: number;
}

export interface Mark {
  readonly type: "mark";
  readonly number: number;
  readonly restart: boolean;
}

export interface FrameEnd {
  readonly type: "frame_end";
  readonly frame: number;
}

export interface Notice {
  readonly type: "notice";
  readonly code: string;
  readonly message: string;
}

export interface Refusal {
  readonly type: "refusal";
  readonly code: string;
  readonly field: string;
  readonly message: string;
}

export interface Fragment {
  readonly type: "fragment";
  readonly seq: number;
  readonly ident: number;
  readonly offset: number;
  readonly total: number;
}

export interface Abandon {
  readonly type: "abandon";
  readonly idents: readonly number[];
}

export type Data = Blob | TileLayers | ReferenceFrame | FrameEnd | Mark;
export type Message =
  | Hello | PoseBatch | Ack | Control | KeyframeRequest | Bye | Ping | Pong
  | Welcome | Notice | Refusal | Fragment | Abandon | Data;
export type Tag = Message["type"];

/** One field of a header; with a default it is left out when equal to it. */
export interface Field {
  readonly name: string;
  readonly kind: Kind<unknown>;
  readonly fallback?: unknown;
}

/** `none`; `opaque`: beside the message; else the name of the bytes field that travels as the payload. */
export interface Spec {
  readonly payload: "none" | "opaque" | "inventory" | "info";
  /** The type in headers with numbers for keys, which messages of every frame have; a field's key is its place, from 1. */
  readonly code?: number;
  readonly fields: readonly Field[];
}

function field(name: string, kind: unknown, fallback?: unknown): Field {
  return { name, kind: kind as Kind<unknown>, ...(fallback === undefined ? {} : { fallback }) };
}

const ANY_TIME = wide(2n ** 62n);
const TIME = ANY_TIME as Kind<number>; // our own times are exact numbers; a peer's may be beyond, and then are bigints
const FRAME = integer(2 ** 31 - 1);
const TILE = integer(2 ** 16 - 1);
const LOD = integer(limits.MAX_LODS);
const SEQ = integer(2 ** 53);
const CRC = integer(2 ** 32 - 1);
const TEXT = text(limits.MAX_TEXT_BYTES);
const SAMPLE = record<WireSample>({ t_us: TIME, pose });
const HELD = record<HeldTile>({ frame: FRAME, tile: TILE, lods: LOD });
const RANGE = record<SeqRange>({ first: SEQ, last: SEQ }, (range) => {
  if (range.first > range.last) throw new RangeError(`range ${range.first}..${range.last} is empty`);
});
const BLOB_BYTES = integer(limits.MAX_BLOB_BYTES);
const MESSAGE_BYTES = integer(limits.MAX_MESSAGE_BYTES);


export const SPECS: { readonly [T in Tag]: Spec } = {
  hello: {
    payload: "inventory",
    fields: [
      field("version", integer(2 ** 16)),
      field("intrinsics", intrinsics),
      field("pose", pose),
      field("near", real(1e-6, 1e6), 0.2),
      field("start_frame", FRAME, 0),
      field("token", TEXT, ""),
      field("agent", TEXT, ""),
      field("resume", TEXT, ""),
      field("references", choice("any", "picture", "none"), "any"),
      field("chroma", choice("yuv444p", "yuv420p"), "yuv444p"),
    ],
  },
  poses: {
    code: 8,
    payload: "none",
    fields: [
      field("samples", listOf(SAMPLE, limits.MAX_POSE_SAMPLES)),
      field("cadence_permille", integer(EVERY_FRAME, LEAST_PERMILLE), EVERY_FRAME),
    ],
  },
  ack: {
    code: 7,
    payload: "none",
    fields: [
      field("ranges", listOf(RANGE, limits.MAX_ACK_RANGES)),
      field("received_us", TIME),
      field("delay_us", TIME, 0),
      field("buffered_bytes", SEQ, 0),
      field("evicted", listOf(HELD, limits.MAX_EVICTED_TILES), []),
    ],
  },
  control: {
    payload: "none",
    fields: [
      field("action", choice("play", "pause", "seek", "rate")),
      field("frame", FRAME),
      field("at_us", TIME),
      field("rate", real(0.01, 16), 1),
      field("loop", flag, false),
      field("keeps", flag, false),
    ],
  },
  keyframe: { payload: "none", fields: [field("reference_seq", SEQ)] },
  bye: { payload: "none", fields: [field("reason", TEXT, "")] },
  ping: { payload: "none", fields: [field("t_us", ANY_TIME)] },
  pong: { payload: "none", fields: [field("t_us", ANY_TIME)] },
  welcome: {
    payload: "info",
    fields: [
      field("session", TEXT),
      field("fps", real(0.01, 1000)),
      field("frames", FRAME),
      field("resumed", flag, false),
    ],
  },
  blob: { payload: "opaque", fields: [field("name", TEXT), field("offset", BLOB_BYTES), field("total", BLOB_BYTES)] },
  tile: {
    code: 2,
    payload: "opaque",
    fields: [
      field("frame", FRAME),
      field("tile", TILE),
      field("from_lod", LOD),
      field("to_lod", LOD),
      field("sizes", listOf(MESSAGE_BYTES, limits.MAX_LODS)),
      field("crcs", listOf(CRC, limits.MAX_LODS), []),
    ],
  },
  reference: {
    code: 3,
    payload: "opaque",
    fields: [
      field("frame", FRAME),
      field("seq", SEQ),
      field("pose", pose),
      field("intrinsics", intrinsics),
      field("idr", flag, false),
      field("kind", choice("difference", "picture", "nothing"), "picture"),
      field("basis", SEQ, 0),
      field("knee", real(1e-3, 10), 0.1),
      field("error", real(0, 1), 0),
      field("reach", real(0, 10), 0.2),
    ],
  },
  mark: { code: 4, payload: "none", fields: [field("number", SEQ), field("restart", flag, false)] },
  frame_end: { code: 5, payload: "opaque", fields: [field("frame", FRAME)] },
  notice: { payload: "none", fields: [field("code", TEXT), field("message", TEXT)] },
  refusal: { payload: "none", fields: [field("code", TEXT), field("field", TEXT), field("message", TEXT)] },
  fragment: {
    code: 1,
    payload: "opaque",
    fields: [
      field("seq", SEQ),
      field("ident", SEQ),
      field("offset", MESSAGE_BYTES, 0),
      field("total", MESSAGE_BYTES, 0),
    ],
  },
  abandon: { code: 6, payload: "none", fields: [field("idents", listOf(SEQ, limits.MAX_PARTIAL_MESSAGES))] },
};
