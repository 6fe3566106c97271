/** Where the visitor is: a camera that orbits, walks or flies, and never rolls. */

import type { Pose, SceneInfo, Vec3 } from "../seam.ts";
import { type Axes, axesOf, clamp, cross, dot, minus, plus, quaternionOf, scaled, unit } from "./vectors.ts";

export const MODES = ["orbit", "walk", "fly"] as const;
export type Mode = (typeof MODES)[number];

/** A sphere that just touches the picture's rim has this much room around it. */
const MARGIN = 1.08;
const MAX_PITCH = 1.5;
const START_PITCH = -0.12;

/** Bounds that reach this many radii beyond the scene's centre are of what stands around it: the view begins within. */
const SURROUNDED = 1.3;
/** Of the way to the bounds. */
const WITHIN = 0.85;
/** Radii from the scene's centre beyond which splats are background, and need not be in the first view. */
const BULK = 2.2;
/** Smallest radius of a scene, in its units: squares of it are still normal numbers in 32-bit floats. */
const LEAST_RADIUS = 1e-12;
/** Smallest radius relative to the centre's coordinates: a few steps of 32-bit floats, which the GPU holds positions in. */
const LEAST_SHARE = 2 ** -20;

/** Tangent of half the height of the picture, 8:5, that an author's pose is of. */
const AUTHORS_TAN = Math.tan(Math.PI / 6) * (5 / 8);

/** How much farther than the author's pose a visitor stands whose picture is narrower, so that as much is seen. */
export function fartherThanAuthor(tanX: number, tanY: number): number {
  return Math.max(1, AUTHORS_TAN / Math.min(tanX, tanY));
}

/** Where a scene is, and how its author wants it to be opened. `cags_common.bundle.first_view` chooses the same view. */
export type Place = Pick<SceneInfo, "up" | "focusCentre" | "focusRadius" | "bounds" | "view">;

export class ViewCamera {
  mode: Mode = "orbit";
  readonly #up: Vec3;
  readonly #front: Vec3;
  readonly #side: Vec3;
  readonly #focus: Vec3;
  readonly #radius: number;
  readonly #bounds: SceneInfo["bounds"];
  readonly #view: SceneInfo["view"];
  #yaw = 0;
  #pitch = START_PITCH;
  #distance = 1;
  #target: Vec3;

  constructor(scene: Place) {
    this.#up = unit(scene.up);
    const seed: Vec3 = Math.abs(this.#up[0]) < 0.9 ? [1, 0, 0] : [0, 0, 1];
    this.#front = unit(cross(seed, this.#up)); // where somebody who looks at the scene stands
    this.#side = cross(this.#up, this.#front); // on their right
    this.#view = scene.view;
    this.#focus = scene.view.target ?? scene.focusCentre;
    const least = Math.max(LEAST_RADIUS, LEAST_SHARE * Math.max(...this.#focus.map(Math.abs)));
    this.#radius = Math.max(scene.view.radius ?? scene.focusRadius, least);
    this.#bounds = scene.bounds;
    this.#target = this.#focus;
  }

  /** Go to the author's first view; else where the whole scene is in a view of these tangents of half its angles, or as
   * far back as a room's walls let. */
  home(tanX: number, tanY: number): void {
    if (this.#view.pose) {
      this.place(this.#view.pose);
      this.#distance *= fartherThanAuthor(tanX, tanY);
      return;
    }
    this.#yaw = 0;
    this.#pitch = START_PITCH;
    this.#target = this.#focus;
    const wall = this.#reach(scaled(this.#axes()[2], -1));
    const round = (this.#radius * MARGIN) / Math.sin(Math.atan(Math.min(tanX, tanY)));
    this.#distance = round;
    if (this.#view.target || this.#view.radius) return;
    if (wall > SURROUNDED * this.#radius) this.#distance = Math.min(round, WITHIN * wall);
    else this.#fit(tanX, tanY);
  }

  /** Bring the corners of the bounds, less what lies far from the scene's centre, into the view. Not from within the
   * scene's ball: bounds are of the splats' centres, and have no extent where all lie at one point; the ball says how
   * large the splats are. */
  #fit(tanX: number, tanY: number): void {
    const reach = BULK * this.#radius;
    const low = this.#bounds[0].map((part, axis) => Math.max(part, this.#focus[axis] - reach));
    const high = this.#bounds[1].map((part, axis) => Math.min(part, this.#focus[axis] + reach));
    const [x, y, z] = this.#axes();
    const target = low.map((part, axis) => (part + high[axis]) / 2) as unknown as Vec3;
    let distance = 0;
    for (let corner = 0; corner < 8; corner++) {
      const at = low.map((part, axis) => (corner & (1 << axis) ? high[axis] : part)) as unknown as Vec3;
      const way = minus(at, target);
      const needed = Math.max(Math.abs(dot(way, x)) / tanX, Math.abs(dot(way, y)) / tanY) - dot(way, z);
      distance = Math.max(distance, needed);
    }
    if (distance < this.#radius) return;
    this.#target = target;
    this.#distance = distance;
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

  /** What the camera turns around, and how much of the scene a first view shows. */
  get around(): { readonly target: Vec3; readonly radius: number } {
    return { target: this.#target, radius: this.#radius };
  }

  get pose(): Pose {
    const axes = this.#axes();
    return { position: plus(this.#target, axes[2], -this.#distance), rotation: quaternionOf(axes) };
  }

  /** Look farther to the right and up by angles in radians: on the spot, or from another side of the target when
   * orbiting, whose front then turns to the right and up. */
  turn(right: number, up: number): void {
    const eye = this.pose.position;
    this.#yaw += right;
    this.#pitch = clamp(this.#pitch + up, -MAX_PITCH, MAX_PITCH);
    if (this.mode !== "orbit") this.#target = plus(eye, this.#axes()[2], this.#distance);
  }

  /** Turn so that what is seen goes to the right and down, as the hand does that has hold of it. */
  drag(right: number, down: number): void {
    if (this.mode === "orbit") this.turn(right, -down);
    else this.turn(-right, down);
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

  #axes(): Axes {
    const level = plus(scaled(this.#front, -Math.cos(this.#yaw)), this.#side, Math.sin(this.#yaw));
    const forward = plus(scaled(level, Math.cos(this.#pitch)), this.#up, Math.sin(this.#pitch));
    const right = unit(cross(forward, this.#up));
    return [right, cross(forward, right), forward];
  }
}
