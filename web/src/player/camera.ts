/** Where the visitor is: a camera that orbits, walks or flies, and never rolls. */

import type { Pose, SceneInfo, Vec3 } from "../seam.ts";
import { type Axes, axesOf, clamp, cross, dot, minus, plus, quaternionOf, scaled, unit } from "./vectors.ts";

export const MODES = ["orbit", "walk", "fly"] as const;
export type Mode = (typeof MODES)[number];

/** A scene that just touches the picture's rim has this much room around it. */
const MARGIN = 1.08;
const MAX_PITCH = 1.5;
const START_PITCH = -0.12;

/** Bounds that reach this many radii beyond the scene's centre are of what stands around it: the view begins within. */
const SURROUNDED = 1.3;
/** Of the way to the bounds. */
const WITHIN = 0.85;

type Place = Pick<SceneInfo, "up" | "focusCentre" | "focusRadius" | "bounds">;

export class ViewCamera {
  mode: Mode = "orbit";
  readonly #up: Vec3;
  readonly #front: Vec3;
  readonly #side: Vec3;
  readonly #focus: Vec3;
  readonly #radius: number;
  readonly #bounds: SceneInfo["bounds"];
  #yaw = 0;
  #pitch = START_PITCH;
  #distance = 1;
  #target: Vec3;

  constructor(scene: Place) {
    this.#up = unit(scene.up);
    const seed: Vec3 = Math.abs(this.#up[0]) < 0.9 ? [1, 0, 0] : [0, 0, 1];
    this.#front = unit(cross(seed, this.#up)); // where somebody who looks at the scene stands
    this.#side = cross(this.#front, this.#up);
    this.#focus = scene.focusCentre;
    this.#radius = Math.max(scene.focusRadius, 1e-3);
    this.#bounds = scene.bounds;
    this.#target = this.#focus;
  }

  /** Go where the whole scene is in a view of these tangents of half its angles, or as far back as a room's walls let. */
  home(tanX: number, tanY: number): void {
    const narrow = Math.sin(Math.atan(Math.min(tanX, tanY)));
    this.#yaw = 0;
    this.#pitch = START_PITCH;
    this.#target = this.#focus;
    const away = scaled(this.#axes()[2], -1);
    const wall = this.#reach(away);
    const whole = (this.#radius * MARGIN) / narrow;
    this.#distance = wall > SURROUNDED * this.#radius ? Math.min(whole, WITHIN * wall) : whole;
  }

  /** How far it is from the scene's centre to its bounds along a direction. */
  #reach(direction: Vec3): number {
    const [low, high] = this.#bounds;
    const ways = direction.map((part, axis) => ((part > 0 ? high : low)[axis] - this.#focus[axis]) / part);
    return Math.min(...ways.filter((way) => Number.isFinite(way) && way >= 0));
  }

  /** Go to a pose; a roll is left behind. */
  place({ position, rotation }: Pose): void {
    const forward = axesOf(rotation)[2];
    this.#pitch = clamp(Math.asin(clamp(dot(forward, this.#up), -1, 1)), -MAX_PITCH, MAX_PITCH);
    this.#yaw = Math.atan2(dot(forward, this.#side), -dot(forward, this.#front));
    this.#distance = Math.max(dot(minus(this.#focus, position), forward), 0.2 * this.#radius);
    this.#target = plus(position, this.#axes()[2], this.#distance);
  }

  get pose(): Pose {
    const axes = this.#axes();
    return { position: plus(this.#target, axes[2], -this.#distance), rotation: quaternionOf(axes) };
  }

  /** Turn by angles in radians: about the target when orbiting, else on the spot. */
  turn(yaw: number, pitch: number): void {
    if (this.mode === "orbit") return this.#orbit(yaw, pitch);
    const eye = this.pose.position;
    this.#orbit(-yaw, -pitch);
    this.#target = plus(eye, this.#axes()[2], this.#distance);
  }

  /** Move by shares of the target's distance along right, down and forward; walking stays on its level. */
  move(right: number, down: number, forward: number): void {
    const [x, y, z] = this.#axes();
    const level = this.mode === "walk" ? unit(cross(this.#up, x)) : z;
    const fall = this.mode === "walk" ? scaled(this.#up, -1) : y;
    const step = plus(plus(scaled(x, right), fall, down), level, forward);
    this.#target = plus(this.#target, step, Math.min(this.#distance, 3 * this.#radius));
  }

  /** Shift the picture by shares of the distance: what was grasped stays under the hand. */
  pan(right: number, down: number): void {
    const [x, y] = this.#axes();
    this.#target = plus(this.#target, plus(scaled(x, right), y, down), this.#distance);
  }

  /** Come nearer (factor under 1) or go away; when walking or flying a step forward or back. */
  dolly(factor: number): void {
    if (this.mode === "orbit") this.#distance = clamp(this.#distance * factor, 0.02 * this.#radius, 40 * this.#radius);
    else this.move(0, 0, 1 - factor);
  }

  #orbit(yaw: number, pitch: number): void {
    this.#yaw += yaw;
    this.#pitch = clamp(this.#pitch + pitch, -MAX_PITCH, MAX_PITCH);
  }

  #axes(): Axes {
    const level = plus(scaled(this.#front, -Math.cos(this.#yaw)), this.#side, Math.sin(this.#yaw));
    const forward = plus(scaled(level, Math.cos(this.#pitch)), this.#up, Math.sin(this.#pitch));
    const right = unit(cross(forward, this.#up));
    return [right, cross(forward, right), forward];
  }
}
