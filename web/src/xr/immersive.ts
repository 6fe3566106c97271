/** A visit in a headset: a session of WebXR from its beginning to its end, and what hands do in it. */

import type { Viewpoint } from "../player/player.ts";
import type { Camera, Pose, Vec3 } from "../seam.ts";
import { EyeLayer } from "./layer.ts";
import { intrinsicsOfProjection, poseOfTransform, Stance, viewpointOf } from "./views.ts";

const MOVES_M_PER_S = 1.5;
const GROWS_PER_S = 2;
const SNAP_RAD = Math.PI / 6;
const STICK_REST = 0.2;
/** A stick that turns does so once it is pushed so far, and again when it has come back. */
const STICK_SNAPS = 0.7;
/** Sticks of `xr-standard` gamepads: across and down. */
const STICK = [2, 3] as const;

/** What a visit needs of the page. */
export interface Visit {
  /** The scene's. */
  readonly up: Vec3;
  /** Of both eyes together, at most; more is brought up. */
  readonly mostPixels: number;
  /** Behind the splats. */
  readonly background: readonly [number, number, number];
  /** Where the visitor begins, and is brought back to. */
  start(): Pose;
  /** The eyes are known: {@link Immersive.viewpoint} is there. */
  began(viewpoint: Viewpoint): void;
  /** Before each refresh of the headset. */
  step(): void;
  toggle(): void;
  /** Nobody looks for a while, or again. */
  rest(rested: boolean): void;
  ended(): void;
}

/** Whether a headset is there that this browser brings scenes to; told again when one comes or goes. */
export function watchHeadset(tell: (there: boolean) => void): void {
  const { xr } = navigator;
  if (!xr) return;
  const look = (): void => void xr.isSessionSupported("immersive-vr").then(tell, () => tell(false));
  xr.addEventListener("devicechange", look);
  look();
}

export class Immersive {
  /** Where the eyes are; null until the headset has said. */
  viewpoint: Viewpoint | null = null;
  readonly layer: EyeLayer;
  readonly stance: Stance;
  readonly #session: XRSession;
  readonly #space: XRReferenceSpace;
  readonly #visit: Visit;
  #centred = false;
  #turned = false; // since the stick was at rest
  #lastMs: number | null = null;

  private constructor(session: XRSession, space: XRReferenceSpace, layer: EyeLayer, visit: Visit) {
    this.#session = session;
    this.#space = space;
    this.layer = layer;
    this.#visit = visit;
    this.stance = new Stance(visit.up);
    session.addEventListener("select", () => visit.toggle());
    session.addEventListener("squeeze", () => this.recentre());
    space.addEventListener("reset", () => (this.#centred = false)); // the headset's own recentring
    session.addEventListener("visibilitychange", () => visit.rest(session.visibilityState === "hidden"));
    session.addEventListener("end", () => this.#end());
    session.requestAnimationFrame((now, frame) => this.#frame(now, frame));
  }

  /** Begin, from within a press of a button. Throws what keeps the headset from it. */
  static async enter(visit: Visit): Promise<Immersive> {
    const session = await navigator.xr!.requestSession("immersive-vr");
    try {
      const layer = await EyeLayer.make();
      const baseLayer = new XRWebGLLayer(session, layer.gl, { alpha: false, antialias: false, depth: false });
      session.updateRenderState({ baseLayer });
      return new Immersive(session, await session.requestReferenceSpace("local"), layer, visit);
    } catch (error) {
      await session.end();
      throw error;
    }
  }

  leave(): void {
    this.#session.end().catch(() => undefined); // it has ended by itself, or is about to
  }

  /** Back to where the visit began, at one's own size. */
  recentre(): void {
    this.stance.scale = 1;
    this.#centred = false;
  }

  /** Take a picture of an eye. */
  keep(eye: number, of: number, camera: Camera, picture: ImageBitmap): void {
    if (this.viewpoint) this.layer.keep(eye, of, camera, picture);
  }

  #frame(nowMs: number, frame: XRFrame): void {
    this.#session.requestAnimationFrame((now, next) => this.#frame(now, next));
    const pose = frame.getViewerPose(this.#space);
    const target = this.#session.renderState.baseLayer;
    if (!pose || !target) return;
    const head = poseOfTransform(pose.transform);
    if (!this.#centred) this.stance.stand(head, this.#visit.start());
    this.#centred = true;
    this.#hands(head, Math.min((nowMs - (this.#lastMs ?? nowMs)) / 1000, 0.1));
    this.#lastMs = nowMs;
    const ports = pose.views.map((view) => target.getViewport(view)!);
    const share = Math.min(1, Math.sqrt(this.#visit.mostPixels / ports.reduce((sum, { width, height }) => sum + width * height, 1)));
    const eyes = pose.views.map((view, i) => {
      const [width, height] = [ports[i].width, ports[i].height].map((px) => Math.max(16, Math.round(px * share)));
      const placed = this.stance.place(poseOfTransform(view.transform));
      return { view, now: { pose: placed, intrinsics: intrinsicsOfProjection(view.projectionMatrix, width, height) } };
    });
    const first = this.viewpoint === null;
    this.viewpoint = viewpointOf(this.stance.place(head).rotation, eyes.map(({ now }) => now));
    if (first) this.#visit.began(this.viewpoint);
    this.#visit.step();
    this.layer.draw(target, eyes, this.#visit.background);
  }

  /** The left stick walks; the right one turns by steps, and makes the visitor larger and smaller. */
  #hands(head: Pose, seconds: number): void {
    for (const { gamepad, handedness } of this.#session.inputSources) {
      const [across, down] = STICK.map((i) => {
        const pushed = gamepad?.axes[i] ?? 0;
        return Math.abs(pushed) < STICK_REST ? 0 : pushed;
      });
      if (handedness !== "right") {
        this.stance.move(head, across * MOVES_M_PER_S * seconds, -down * MOVES_M_PER_S * seconds);
        continue;
      }
      if (Math.abs(across) >= STICK_SNAPS && !this.#turned) this.stance.turn(head, -Math.sign(across) * SNAP_RAD);
      this.#turned = across !== 0 && (this.#turned || Math.abs(across) >= STICK_SNAPS);
      if (down && !across) this.stance.grow(head, GROWS_PER_S ** (-down * seconds));
    }
  }

  #end(): void {
    this.viewpoint = null;
    this.layer.destroy();
    this.#visit.ended();
  }
}
