/** What this page and a Python client behind it say to each other: `cags_client.output.page.messages`, the other side.
 *
 * The page sends texts. The client sends texts, and for each shown frame one binary message: the length of the header
 * (u32, big-endian), the header (JSON), then pictures and grids in the header's order. Names are those of the texts. */

import type { Pose, Quat, Vec3 } from "../seam.ts";

/** What the browser shows besides JPEG: H.264 by WebCodecs, pictures as they are (4:2:0). */
export interface Formats {
  readonly h264: boolean;
  readonly raw: boolean;
}

/** Pictures and overlays that are wanted: one picture, or two under a wipe. */
export interface Look {
  readonly pictures: readonly string[];
  readonly overlays: readonly string[];
}

/** What may be set, and to what; `frame` is gone to, `held` is told off to follow the recorded walk. */
export type Wish =
  | readonly [name: "playing" | "loop" | "held", value: boolean]
  | readonly [name: "frame" | "rate" | "delay_ms", value: number]
  | readonly [name: "cap_mbps", value: number | null]
  | readonly [name: string, value: string];

export const hello = (formats: Formats, token?: string): string => JSON.stringify({ type: "hello", ...formats, ...(token ? { token } : {}) });
/** Where the camera was at `atUs` of the page's clock, told back with the picture that shows it. */
export const moved = (atUs: number, { position, rotation }: Pose): string => JSON.stringify({ type: "pose", at_us: atUs, position, rotation });
/** Pictures are shown on so many pixels of the screen. */
export const windowed = (width: number, height: number): string => JSON.stringify({ type: "window", width, height });
export const look = ({ pictures, overlays }: Look): string => JSON.stringify({ type: "look", pictures, overlays });
export const set = (...[name, value]: Wish): string => JSON.stringify({ type: "set", name, value });
/** The picture of this number is on the screen; `key`: it could not be, and needs one that is decoded by itself. */
export const drawn = (number: number, key: boolean): string => JSON.stringify({ type: "shown", number, key });

/** The scene, and what may be looked at and chosen. */
export interface SceneText {
  readonly type: "scene";
  readonly name: string;
  readonly frames: number;
  readonly fps: number;
  readonly up: Vec3;
  readonly focus_centre: Vec3;
  readonly focus_radius: number;
  readonly bounds: readonly [Vec3, Vec3];
  readonly lods: number;
  readonly view: { readonly title?: string; readonly background?: string; readonly pose?: readonly number[]; readonly target?: Vec3; readonly radius?: number };
  readonly pictures: readonly string[];
  readonly overlays: readonly string[];
  /** Choices of each setting. */
  readonly settings: Readonly<Record<string, readonly string[]>>;
  readonly shaper: boolean;
}

/** How things stand. */
export interface StateText {
  readonly type: "state";
  readonly playing: boolean;
  readonly loop: boolean;
  readonly rate: number;
  /** Whether somebody has hold of the camera; else it follows the recorded walk. */
  readonly held: boolean;
  /** Whether camera and play are this page's; else it watches another's. */
  readonly steers: boolean;
  /** The client has lost its server, and looks for it. */
  readonly away: boolean;
  readonly settings: Readonly<Record<string, string>>;
  readonly shaper: { readonly error?: string; readonly cap_mbps?: number | null; readonly delay_ms?: number; readonly capacity_mbps?: number } | null;
}

export interface ErrorText {
  readonly type: "error";
  readonly text: string;
}

export type ClientText = SceneText | StateText | ErrorText;

export interface PictureHead {
  readonly name: string;
  /** A codec string of WebCodecs, `jpeg` or `i420`. */
  readonly codec: string;
  readonly key: boolean;
  readonly width: number;
  readonly height: number;
  readonly bytes: number;
}

/** A byte an area of the picture, row by row. */
export interface GridHead {
  readonly name: string;
  readonly width: number;
  readonly height: number;
  readonly bytes: number;
}

/** From x0, y0 to x1, y1, in shares of the picture. */
export type Line = readonly [number, number, number, number];

export interface FrameHead {
  readonly number: number;
  readonly pose_at_us: number | null;
  readonly pictures: readonly PictureHead[];
  readonly overlays: { readonly grids: readonly GridHead[]; readonly tiles?: readonly { readonly detail: number; readonly lines: readonly Line[] }[]; readonly reference?: readonly Line[] };
  /** Pictures that were asked for and that this frame has none of. */
  readonly missing: readonly string[];
  readonly frame: number;
  readonly missed: boolean;
  readonly resolution: string;
  readonly camera: { readonly position: Vec3; readonly rotation: Quat; readonly fov_y: number };
  readonly stages_ms: Readonly<Record<string, number>>;
  readonly stats: Readonly<Record<string, number | null>>;
}

export interface FrameMessage {
  readonly head: FrameHead;
  readonly pictures: readonly Uint8Array<ArrayBuffer>[];
  readonly grids: readonly Uint8Array<ArrayBuffer>[];
}

/** Take a frame's message apart; what it carries stays where it lies. */
export function unpack(data: ArrayBuffer): FrameMessage {
  const length = new DataView(data).getUint32(0);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))) as FrameHead;
  let at = 4 + length;
  const next = ({ bytes }: { readonly bytes: number }): Uint8Array<ArrayBuffer> => new Uint8Array(data, (at += bytes) - bytes, bytes);
  return { head, pictures: head.pictures.map(next), grids: head.overlays.grids.map(next) };
}
