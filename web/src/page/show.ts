/** What the page asks of whatever brings it a scene: drawn here from splats, or by a client that sends pictures. */

import type { ViewCamera } from "../player/camera.ts";
import type { Pose } from "../seam.ts";
import type { Opened } from "./author.ts";
import type { Figure } from "./inspector.ts";
import type { Verdict } from "./light.ts";
import type { Messages } from "./messages.ts";
import type { Place } from "./place.ts";
import type { Angles } from "./view.ts";

/** The view until a scene says where it is. */
export const NOWHERE: Pose = { position: [0, 0, 0], rotation: [1, 0, 0, 0] };

/** {@link Show.trouble} while the server is looked for. */
export const SERVER_AWAY = ["The server is not there", "The picture stands on what has come; it goes on by itself."] as const;

/** A play of a scene. */
export interface Playing {
  /** Null until it is known. */
  readonly info: { readonly name: string; readonly frames: number; readonly fps: number } | null;
  readonly playing: boolean;
  /** Whether a place was gone to that is not there yet. */
  readonly waiting: boolean;
  /** The media frame on display, or that the play goes to. */
  readonly frame: number;
  readonly seconds: number;
  /** Pictures shown. */
  readonly pictures: number;
  /** What was shown last; null before the first picture. */
  readonly shown: object | null;
  play(): void;
  pause(): void;
  seek(frame: number): void;
  setRate(rate: number): void;
  setLoop(on: boolean): void;
  /** The page is not seen any more, or again. */
  rest(rested: boolean): void;
  /** Before each refresh of the screen. */
  step(): void;
  close(): void;
}

/** Brings a scene onto the page's canvas. */
export interface Show {
  readonly player: Playing | null;
  /** Headline and hint of what keeps the picture from going on; null where nothing does. */
  readonly trouble: readonly [headline: string, hint: string] | null;
  readonly verdict: Verdict;
  /** Whether a headset shows the scene, and sets the pace, in place of this page. */
  readonly immersed: boolean;
  /** For the inspector; `rate`: pictures a second. */
  figures(rate: number): readonly Figure[];
  /** Join, from the beginning. */
  begin(): Promise<void>;
  /** Have what is shown on the canvas, to be read in this turn. */
  present(): void;
  /** Go into the headset, or come back; where there is none nothing happens. */
  immerse(): void;
}

/** The page, as a {@link Show} sees it. */
export interface Host {
  readonly canvas: HTMLCanvasElement;
  readonly messages: Messages;
  /** What the address says, and what was said since. */
  place: Place;
  /** Of the picture. */
  angles: Angles;
  readonly camera: ViewCamera | null;
  /** Begin at the first view of a scene, or where the address says. */
  stand(scene: Opened): void;
  /** The scene plays. */
  ready(): void;
  /** Before each refresh of whatever shows the scene. */
  step(nowMs: number): void;
  /** Reload the page, and go on from where the play and the camera are; `why` is said then. Returns false, and does
   * nothing, if the page was reloaded only just now. */
  reload(why: string): boolean;
  /** Say why not, here and to a page around this one. */
  failed(headline: string, message: string, way?: "again" | "scenes" | "none"): void;
}
