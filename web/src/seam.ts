/**
 * The seam between what receives a scene and what shows it.
 *
 * A {@link SceneSource} brings a scene: from a server over a WebSocket, or from a published folder over HTTP. It decodes,
 * stores and commits; a player asks it for one media frame after another, uploads what changed to the GPU, decodes
 * reference video, draws, and decides what is shown when. Sources live in a worker ({@link connectWorker} in
 * `source/remote.ts` gives the page the same interface), so every value here can be posted between threads; typed arrays
 * of a {@link FrameUpdate} and of a {@link Reference} are transferred, and belong to whoever received them.
 *
 * Conventions are those of the whole project: right-handed world, metres; cameras look along +Z with +X right and +Y down
 * (OpenCV); poses are `T_world_camera`; quaternions `wxyz`, unit, w >= 0; pixel centres at +0.5. Times named `Us` are whole
 * microseconds of {@link nowUs}, the same clock in every thread of a page: the master clock of a session.
 */

/** Microseconds of this page's monotonic clock, whole; equal in window and workers. */
export function nowUs(): number {
  return Math.round((performance.timeOrigin + performance.now()) * 1000);
}

export type Vec3 = readonly [number, number, number];
export type Quat = readonly [number, number, number, number];

/** T_world_camera: where the camera is (metres, world) and how it is turned (`wxyz`, unit, w >= 0). */
export interface Pose {
  readonly position: Vec3;
  readonly rotation: Quat;
}

/** A pinhole, pixels. */
export interface Intrinsics {
  readonly widthPx: number;
  readonly heightPx: number;
  readonly fxPx: number;
  readonly fyPx: number;
  readonly cxPx: number;
  readonly cyPx: number;
}

export interface Camera {
  readonly intrinsics: Intrinsics;
  readonly pose: Pose;
  /** Metres. */
  readonly near: number;
}

/** How the author wants a scene to be opened; what is left out, players choose. */
export interface AuthorView {
  readonly title?: string;
  /** Behind the splats, `#rrggbb`. */
  readonly background?: string;
  /** Where a play begins. */
  readonly pose?: Pose;
  /** Point to turn around. */
  readonly target?: Vec3;
  /** Of the sphere about the target that a first view shows whole, metres. */
  readonly radius?: number;
}

/** What a player knows of the scene: the public manifest, less what only decoders need. */
export interface SceneInfo {
  readonly name: string;
  readonly fps: number;
  readonly frames: number;
  /** First frame of each group of frames. */
  readonly gofStarts: readonly number[];
  /** Splat ids of each group: rows of the GPU's buffers. */
  readonly capacity: readonly number[];
  /** Whether decoders keep all groups of frames, and so can loop the clip and seek in it without new data. */
  readonly keptWhole: boolean;
  readonly shDegree: 0 | 1 | 2 | 3;
  /** Smallest and largest corner of all positions. */
  readonly bounds: readonly [Vec3, Vec3];
  /** Levels of detail, 0 .. lods - 1. */
  readonly lods: number;
  readonly codec: string;
  readonly up: Vec3;
  readonly focusCentre: Vec3;
  readonly focusRadius: number;
  readonly near: number;
  /** Whether frames come as fast as the link brings them, and the play waits for them; else they come in time or not. */
  readonly waits: boolean;
  /** Whether splats move by themselves, so that moments between media frames differ. */
  readonly moves: boolean;
  readonly view: AuthorView;
  /** The manifest as it came (JSON), for what is not listed here. */
  readonly manifest: Readonly<Record<string, unknown>>;
}

export type ReferencesWanted = "any" | "picture" | "none";
export type Chroma = "yuv444p" | "yuv420p";

/** How to join. */
export interface ConnectOptions {
  /** Of the display; references are made for its field of view. */
  readonly intrinsics: Intrinsics;
  readonly pose: Pose;
  /** Media frame to begin at, of a server's scene. */
  readonly startFrame?: number;
  /** Seconds to begin at, of a published scene: only the source learns how many frames a second it has. */
  readonly startSeconds?: number;
  readonly token?: string;
  readonly references?: ReferencesWanted;
  /** The finest colour sampling that the page's video decoder takes. */
  readonly chroma?: Chroma;
  /** Seconds for which a lost connection is tried again; Infinity: until the page closes. */
  readonly reconnectS?: number;
  /** Rows of a group of frames that are taken on at most. */
  readonly maxSplats?: number;
  /** Memory that a group's splats may take, MB. */
  readonly maxMemoryMb?: number;
}

/** The whole state of play, as the wire's `control`: `frame` is displayed at `atUs`, frame i at
 * `atUs + (i - frame) 1e6 / (fps rate)`. */
export interface PlayState {
  readonly action: "play" | "pause" | "seek" | "rate";
  readonly frame: number;
  readonly atUs: number;
  readonly rate?: number;
  readonly loop?: boolean;
}

export interface PoseSample {
  readonly tUs: number;
  readonly pose: Pose;
}

/** Rows of the scene to replace, as `update.wgsl` stages them: `words` is [rows, 1 + width], a row's index first, then of
 * those groups that are named: motion (mean 3, logit 1, quaternion 4), log scales 3 (looks), base colour 3 (colour),
 * harmonics 3 K (looks). Float32 bits in words. Rows are unique within one patch; patches are applied in order. */
export interface Patch {
  readonly motion: boolean;
  readonly looks: boolean;
  readonly colour: boolean;
  readonly rows: number;
  /** Words of a row after its index. */
  readonly width: number;
  readonly words: Uint32Array<ArrayBuffer>;
}

/** What to commit. */
export interface FrameRequest {
  /** Media frame. */
  readonly frame: number;
  /** Media frames after `frame`, 0 <= share < 1; above 0 only what moves is brought there, after the frame itself. */
  readonly share?: number;
  /** Show what came up to this mark of the store; undefined: everything. {@link References.basis} says which. */
  readonly basis?: number;
  /** Ask which splats have changed, for the veto of a correction. */
  readonly changedSince?: ChangedSince;
  /** Memory of earlier patches that nobody reads any more, for those to come; transferred. */
  readonly spent?: readonly ArrayBuffer[];
}

/** See `cags_client.frame.changes`: since the reference of media frame `frame`, which assumes mark `basis` (undefined: a
 * picture, for which refined looks count as unchanged), as a reference of `focalPx` at the view `camera` would see it. */
export interface ChangedSince {
  readonly frame: number;
  readonly basis?: number;
  readonly camera: Camera;
  readonly focalPx: number;
}

/** What became visible, to be uploaded before the frame is drawn. */
export interface FrameUpdate {
  readonly frame: number;
  readonly share: number;
  /** Group of frames that was asked for. */
  readonly gof: number;
  /** A number for each set of GPU buffers; where it differs from the one before, make buffers anew, of `capacity` rows
   * and `shCount` harmonics a channel: the patches then hold all rows. */
  readonly scene: number;
  readonly fresh: boolean;
  readonly capacity: number;
  readonly shCount: number;
  readonly patches: readonly Patch[];
  /** Rows that changed, and further ones that only moved. */
  readonly changedRows: number;
  readonly movedRows: number;
  /** Highest band of harmonics with anything in it since the group's first frame. */
  readonly shDegree: number;
  /** The end of this frame was not there: something older is shown. */
  readonly missed: boolean;
  /** Everything shown is at its highest level. */
  readonly full: boolean;
  /** Mean level of detail of what is in the view of the last pose sent; NaN where nothing is. */
  readonly lodMean: number;
  /** Mean squared error that it is expected to have, RGB from 0 to 1; NaN where nothing is. */
  readonly ownError: number;
  /** What is there after this frame, ms of play. */
  readonly bufferMs: number;
  /** Newest mark of the store. */
  readonly mark: number;
  /** With `changedSince`: positions [n, 3] and radii [n] (metres) of splats that changed, for `changed_cells`. */
  readonly changed?: { readonly positions: Float32Array<ArrayBuffer>; readonly radii: Float32Array<ArrayBuffer> };
  /** Milliseconds that the source worked for this update. */
  readonly workMs: number;
}

export type ReferenceKind = "difference" | "picture" | "nothing";

/** A reference as it came, not decoded. */
export interface Reference {
  readonly frame: number;
  /** From 1 on each connection, without gaps; of `nothing` that of the last picture. */
  readonly seq: number;
  /** Counts references over all connections. */
  readonly order: number;
  /** The connection, from 1: with a new one the video starts anew. */
  readonly connection: number;
  readonly idr: boolean;
  readonly kind: ReferenceKind;
  readonly camera: Camera;
  /** Mark of the store that it assumes; of a picture it does not matter. */
  readonly basis: number;
  /** Of a difference's compander. */
  readonly knee: number;
  /** Mean squared error that coding has left in a picture, RGB from 0 to 1. */
  readonly error: number;
  /** How far from its camera a difference holds, radians. */
  readonly reach: number;
  /** One H.264 access unit, Annex B, without description; empty where kind is `nothing`. */
  readonly data: Uint8Array<ArrayBuffer>;
}

/** What is wrong, in one plain line; `fatal`: the source has ended and will not come back by itself. */
export interface SourceError {
  readonly code: string;
  readonly message: string;
  readonly fatal: boolean;
}

export type LinkState = "connecting" | "open" | "away" | "ended";

/** Figures for the light and the inspector; sent a few times a second while anything changes. */
export interface Status {
  readonly atUs: number;
  readonly link: LinkState;
  /** Attempts to come back since the connection was lost. */
  readonly attempts: number;
  /** Goodput of the last second, bit/s. */
  readonly goodputBps: number;
  /** Round trip of the newest ping; undefined before any. */
  readonly rttMs?: number;
  /** Bytes that wait for their decoder. */
  readonly undecodedBytes: number;
  readonly bytesTiles: number;
  readonly bytesReference: number;
  readonly bytesOther: number;
  readonly decodeErrors: number;
  readonly damagedPackets: number;
  readonly reconnects: number;
  /** Media frames that are there whole, from the frame on display on. */
  readonly framesAhead: number;
  /** Whether the source brings references. */
  readonly references: boolean;
}

/** What a source tells, in order. `whole`: the newest frame whose end has been decoded; the first one that is at least
 * the start frame is when a player may say `play`. `flushed`: everything before a jump is past; references after it are
 * of the new place (references that were received before it are to be forgotten). `restarted`: a new connection serves
 * the play; references that are there stay in use, the video decoder is reset, and `resumeAt`, where there was a play, is
 * what the source has told the server. `arrived`: tiles, codebooks or parts of messages have come; told
 * until a play has been asked for, while it is held. */
export type SourceEvent =
  | { readonly type: "info"; readonly info: SceneInfo }
  | { readonly type: "arrived"; readonly atUs: number; readonly tile: boolean; readonly equipped: boolean }
  | { readonly type: "whole"; readonly frame: number; readonly mark: number }
  | { readonly type: "reference"; readonly reference: Reference }
  | { readonly type: "mark"; readonly mark: number }
  | { readonly type: "flushed" }
  | { readonly type: "restarted"; readonly connection: number; readonly resumeAt?: PlayState }
  | { readonly type: "notice"; readonly code: string; readonly message: string }
  | { readonly type: "status"; readonly status: Status }
  | { readonly type: "error"; readonly error: SourceError };

/** The first of some frames, and the first one after them. */
export type FrameRange = readonly [first: number, end: number];

export const NO_FRAMES: FrameRange = [0, 0];

export function within([first, end]: FrameRange, frame: number): boolean {
  return frame >= first && frame < end;
}

/** A scene that streams in. Methods return at once, but for `frame`. */
export interface SceneSource {
  /** Begin; `url` is ws(s)://HOST/stream, or http(s)://HOST/FOLDER/ of a published bundle. `listen` hears every event. */
  connect(url: string, options: ConnectOptions, listen: (event: SourceEvent) => void): void;
  /** Say how the play goes: also what has to be sent after a seek. */
  control(state: PlayState): void;
  /** Frames among which the play can jump and go on with what is held (the wire's `keeps`); known after the last `frame`. */
  readonly kept: FrameRange;
  /** Poses since the last call, oldest first, at most 64, and how many of 1,000 media frames are displayed. */
  sendPoses(samples: readonly PoseSample[], cadencePermille?: number): void;
  /** The reference video is broken after `seq` (0: nothing was decoded): ask for an IDR picture. */
  requestKeyframe(seq: number): void;
  /** The display has another pinhole from now on: what follows is made and chosen for it, and nothing that is held is lost. */
  reshape(intrinsics: Intrinsics): void;
  /** Commit a media frame and get what changed. One at a time; frames in order within a pass. Rejects after the end. */
  frame(request: FrameRequest): Promise<FrameUpdate>;
  /** Leave, with a goodbye. */
  close(): void;
}
