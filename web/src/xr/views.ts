/**
 * What a headset says, as cameras of this project. WebXR has +Y up and eyes that look along -Z; here cameras look along +Z
 * with +Y down (OpenCV). Poses of a headset are of its reference space; {@link Stance} brings them into the scene.
 */

import { about, axesOf, canonical, clamp, cross, dot, inverse, minus, plus, product, quaternionOf, scaled, turned, unit } from "../player/vectors.ts";
import type { Viewed, Viewpoint } from "../player/player.ts";
import type { Camera, Intrinsics, Pose, Quat, Vec3 } from "../seam.ts";

/** Metres of the scene a metre of the visitor, at least and at most. */
const SCALES = [0.02, 50] as const;
/** Less of a direction than this lies in the level plane: it says nothing of where somebody faces. */
const UPRIGHT = 0.1;

/** An eye's pinhole of so many pixels, of a projection matrix (column-major, as WebGL has it; any frustum, no skew). */
export function intrinsicsOfProjection(m: ArrayLike<number>, widthPx: number, heightPx: number): Intrinsics {
  return {
    widthPx,
    heightPx,
    fxPx: (m[0] * widthPx) / 2,
    fyPx: (m[5] * heightPx) / 2,
    cxPx: ((1 - m[8]) * widthPx) / 2,
    cyPx: ((1 + m[9]) * heightPx) / 2,
  };
}

/** The pose of a transform of WebXR in its reference space, with OpenCV's camera axes. */
export function poseOfTransform({ position: p, orientation: o }: Pick<XRRigidTransform, "position" | "orientation">): Pose {
  return { position: [p.x, p.y, p.z], rotation: canonical([-o.x, o.w, o.z, -o.y]) }; // half a turn about X
}

/** The middle of the eyes, turned as the head is, with the least centred pinhole that sees all that they see far away. */
export function viewpointOf(head: Quat, eyes: readonly Viewed[]): Viewpoint {
  const middle = scaled(eyes.reduce<Vec3>((sum, { pose }) => plus(sum, pose.position), [0, 0, 0]), 1 / eyes.length);
  let [tanX, tanY, focal] = [0, 0, 0];
  for (const { pose, intrinsics: i } of eyes) {
    const toHead = product(inverse(head), pose.rotation);
    focal = Math.max(focal, i.fxPx, i.fyPx);
    for (const u of [0, i.widthPx])
      for (const v of [0, i.heightPx]) {
        const [x, y, z] = turned(toHead, [(u - i.cxPx) / i.fxPx, (v - i.cyPx) / i.fyPx, 1]);
        [tanX, tanY] = [Math.max(tanX, Math.abs(x / z)), Math.max(tanY, Math.abs(y / z))];
      }
  }
  const [widthPx, heightPx] = [Math.ceil(2 * tanX * focal), Math.ceil(2 * tanY * focal)];
  const intrinsics = { widthPx, heightPx, fxPx: widthPx / (2 * tanX), fyPx: heightPx / (2 * tanY), cxPx: widthPx / 2, cyPx: heightPx / 2 };
  return { pose: { position: middle, rotation: head }, intrinsics, eyes };
}

/**
 * Where `now` sees what `drawn` has drawn, as if all of it were far away: takes (x, y, 1) of clip space, +Y up, to (s, t, 1) w
 * of the picture, 0 to 1 from its left upper corner; w > 0 in front of it. Row-major.
 */
export function reprojection(drawn: Camera, now: Viewed): number[] {
  const { intrinsics: d } = drawn;
  const { intrinsics: n } = now;
  const turn = product(inverse(drawn.pose.rotation), now.pose.rotation);
  const columns = [
    [n.widthPx / 2 / n.fxPx, 0, 0],
    [0, -n.heightPx / 2 / n.fyPx, 0],
    [(n.widthPx / 2 - n.cxPx) / n.fxPx, (n.heightPx / 2 - n.cyPx) / n.fyPx, 1],
  ].map((ray) => {
    const [x, y, z] = turned(turn, ray as unknown as Vec3);
    return [(d.fxPx * x + d.cxPx * z) / d.widthPx, (d.fyPx * y + d.cyPx * z) / d.heightPx, z];
  });
  return [0, 1, 2].flatMap((row) => columns.map((column) => column[row]));
}

/** How a headset's reference space lies in the scene: its floor level, its metres so many of the scene's. */
export class Stance {
  scale = 1;
  readonly #up: Vec3;
  #rotation: Quat = [1, 0, 0, 0];
  #origin: Vec3 = [0, 0, 0];

  constructor(up: Vec3) {
    this.#up = unit(up);
  }

  /** T_world_camera of a pose of the reference space. */
  place({ position, rotation }: Pose): Pose {
    return { position: plus(this.#origin, turned(this.#rotation, position), this.scale), rotation: canonical(product(this.#rotation, rotation)) };
  }

  /** Have the head where the camera `at` is, facing where that faces; the scene's up is the room's. */
  stand(head: Pose, at: Pose): void {
    const [from, to] = [level(head.rotation, [0, 1, 0]), level(at.rotation, this.#up)];
    const column = (axis: 0 | 1 | 2): Vec3 => from.reduce<Vec3>((sum, part, i) => plus(sum, to[i], part[axis]), [0, 0, 0]);
    this.#hold(head, at.position, quaternionOf([column(0), column(1), column(2)]));
  }

  /** Turn the visitor to the left by an angle, radians, on the spot. */
  turn(head: Pose, angle: number): void {
    this.#hold(head, this.place(head).position, canonical(product(about(this.#up, angle), this.#rotation)));
  }

  /** Make the visitor larger (a factor above 1), or smaller; their eyes stay where they are. */
  grow(head: Pose, factor: number): void {
    const at = this.place(head).position;
    this.scale = clamp(this.scale * factor, ...SCALES);
    this.#hold(head, at, this.#rotation);
  }

  /** Go so many of the visitor's own metres, on the level: to the right and forward of where they face. */
  move(head: Pose, right: number, forward: number): void {
    const [x, , back] = level(this.place(head).rotation, this.#up);
    this.#origin = plus(this.#origin, plus(scaled(x, right), back, -forward), this.scale);
  }

  /** Of the rotations and places that there are, that which has the head at `at`. */
  #hold(head: Pose, at: Vec3, rotation: Quat): void {
    this.#rotation = rotation;
    this.#origin = plus(at, turned(rotation, head.position), -this.scale);
  }
}

/** Right, up and back of somebody who stands upright and faces where a camera does. */
function level(rotation: Quat, up: Vec3): readonly [Vec3, Vec3, Vec3] {
  const [, down, forward] = axesOf(rotation);
  const flat = (v: Vec3): Vec3 => minus(v, scaled(up, dot(v, up)));
  let faces = flat(forward);
  if (Math.hypot(...faces) < UPRIGHT) faces = flat(scaled(down, dot(forward, up) < 0 ? -1 : 1)); // straight up or down
  const back = scaled(unit(faces), -1);
  return [cross(up, back), up, back];
}
