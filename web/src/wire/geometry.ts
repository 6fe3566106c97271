/** Poses and pinholes as the wire carries them; checked and made unit as `cags_common.geometry` does. */
import type { Intrinsics, Pose, Quat, Vec3 } from "../seam.ts";

/** The unit quaternion of `q` with w >= 0. Raises `RangeError` for one without a direction. */
export function normaliseQuaternion(q: Quat): Quat {
  const norm = Math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  if (!Number.isFinite(norm) || norm < 1e-12) throw new RangeError(`quaternion ${q} has no direction`);
  const sign = q[0] < 0 ? -1 : 1;
  return [(sign * q[0]) / norm, (sign * q[1]) / norm, (sign * q[2]) / norm, (sign * q[3]) / norm];
}

/** A pose whose rotation is unit with w >= 0. Raises `RangeError` for numbers that are not finite. */
export function makePose(position: Vec3, rotation: Quat): Pose {
  if (!position.every(Number.isFinite)) throw new RangeError(`pose position ${position} is not finite`);
  return { position, rotation: normaliseQuaternion(rotation) };
}

/** Full horizontal and vertical angles, radians, of a centred pinhole of these focal lengths. */
export function fovRad(i: Intrinsics): [number, number] {
  return [2 * Math.atan(i.widthPx / (2 * i.fxPx)), 2 * Math.atan(i.heightPx / (2 * i.fyPx))];
}

/** Rotation (row-major [9]) and translation that take world points to the camera's frame. */
export function worldToCamera(pose: Pose): { rotation: number[]; translation: Vec3 } {
  const [w, x, y, z] = pose.rotation;
  const rotation = [
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y),
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x),
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y),
  ];
  const [px, py, pz] = pose.position;
  const row = (i: number): number => -(rotation[i]! * px + rotation[i + 1]! * py + rotation[i + 2]! * pz);
  return { rotation, translation: [row(0), row(3), row(6)] };
}
