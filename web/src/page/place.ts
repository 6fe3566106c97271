/** What a link says: the scene by name; time, pose, camera mode and how to begin behind the #, which no server sees. */

import type { Pose, Vec3 } from "../seam.ts";
import { MODES, type Mode } from "../player/camera.ts";
import { canonical } from "../player/vectors.ts";

export interface Place {
  /** Seconds of the clip. */
  readonly seconds?: number;
  readonly pose?: Pose;
  readonly mode?: Mode;
  /** Whether to play at once. */
  readonly playing?: boolean;
  readonly loop?: boolean;
  /** Of a server that asks for one. */
  readonly token?: string;
  /** What to turn around. */
  readonly target?: Vec3;
  /** Behind the splats, `#rrggbb`. */
  readonly background?: string;
  /** Pixels to draw at, whatever the window's size. */
  readonly size?: readonly [number, number];
}

/** Coordinates beyond this are nowhere near a scene, and the protocol takes only ten times as much. */
const FARTHEST = 1e8;
/** Shorter quaternions have no direction. */
const LEAST_QUATERNION = 1e-6;

/** The scene that the page's address names, of a server with several. */
export function sceneOf(search: string): string | undefined {
  return new URLSearchParams(search).get("scene") ?? undefined;
}

/** The header that shows a token. Browsers write headers as Latin-1, and the server reads UTF-8. */
export function bearer(token: string): string {
  return `Bearer ${String.fromCharCode(...new TextEncoder().encode(token))}`;
}

/** The # of an address on this server that opens with `token`. */
export function tokenHash(token: string | undefined): string {
  return token ? `#${new URLSearchParams({ token })}` : "";
}

/** The address of `path` beside the page, for the scene that the page shows. */
export function beside(path: string): URL {
  const url = new URL(path, location.href);
  const scene = sceneOf(location.search);
  url.hash = "";
  url.search = scene === undefined ? "" : `?${new URLSearchParams({ scene })}`;
  return url;
}

export function placeOf(hash: string): Place {
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  const numbers = (name: string, count: number): number[] | undefined => {
    const parts = (given.get(name) ?? "").split(",").map(Number);
    return given.has(name) && parts.length === count && parts.every(isNear) ? parts : undefined;
  };
  const [seconds] = numbers("t", 1) ?? [];
  const pose = givenPose(numbers("pose", 7));
  const target = numbers("target", 3);
  const background = given.get("background")?.match(/^#?([0-9a-f]{6})$/i);
  const size = given.get("size")?.match(/^(\d{1,4})x(\d{1,4})$/);
  const mode = MODES.find((known) => known === given.get("camera"));
  const token = given.get("token");
  return {
    ...(seconds === undefined ? {} : { seconds: Math.max(0, seconds) }),
    ...(pose ? { pose } : {}),
    ...(mode ? { mode } : {}),
    ...(target ? { target: target as unknown as Vec3 } : {}),
    ...(background ? { background: `#${background[1]}` } : {}),
    ...(given.has("paused") ? { playing: false } : {}),
    ...(given.has("once") ? { loop: false } : {}),
    ...(token ? { token } : {}),
    ...(size ? { size: [Math.max(16, Number(size[1])), Math.max(16, Number(size[2]))] as const } : {}),
  };
}

/** A pose of seven numbers: position, then quaternion `wxyz`. */
export function poseOf([x, y, z, qw, qx, qy, qz]: readonly number[]): Pose {
  return { position: [x, y, z], rotation: canonical([qw, qx, qy, qz]) };
}

/** The pose of seven numbers that anybody may have written; undefined where they are none. */
export function givenPose(value: unknown): Pose | undefined {
  if (!Array.isArray(value) || value.length !== 7 || !value.every(isNear)) return undefined;
  const pose = value as number[];
  return Math.hypot(...pose.slice(3)) < LEAST_QUATERNION ? undefined : poseOf(pose);
}

function isNear(value: unknown): boolean {
  return typeof value === "number" && Math.abs(value) <= FARTHEST; // nor NaN
}

/** The place where a visit goes on at `hash`: a token is known on until another one is given. */
export function movedTo(hash: string, { token }: Place): Place {
  return { ...(token ? { token } : {}), ...placeOf(hash) };
}

/** What a page leaves to the one that it is loaded anew as. */
export interface Left {
  readonly place: Place;
  /** Why it was loaded anew, to be said. */
  readonly why: string;
}

const LEFT = "cags.left";

/** Leave the whole place, with its token, to the page that is loaded next at `address`, in this tab alone. */
export function leave(storage: Storage, address: string, left: Left): void {
  storage.setItem(LEFT, JSON.stringify({ address, ...left }));
}

/** What was left for the page at `address`, once; undefined where nothing was. */
export function taken(storage: Storage, address: string): Left | undefined {
  const text = storage.getItem(LEFT);
  storage.removeItem(LEFT);
  if (text === null) return undefined;
  const { address: meant, ...left } = JSON.parse(text) as Left & { readonly address: string };
  return meant === address ? left : undefined;
}

/** The # of a link to a moment seen from a pose; the token is not passed on. */
export function hashOf(seconds: number, pose: Pose, mode: Mode): string {
  const short = (x: number): string => String(Number(x.toFixed(4)));
  const parts = [...pose.position, ...pose.rotation].map(short).join(",");
  return `#t=${short(seconds)}&pose=${parts}&camera=${mode}`;
}
