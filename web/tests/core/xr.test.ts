/** A headset's eyes as cameras: what its matrices say is what the renderer draws, and where it is brought back to. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { rotationMatrix } from "../../src/gpu/camera.ts";
import type { Viewed } from "../../src/player/player.ts";
import { axesOf, canonical, cross, dot, inverse, length, minus, plus, quaternionOf, scaled, turned, unit } from "../../src/player/vectors.ts";
import type { Camera, Intrinsics, Pose, Quat, Vec3 } from "../../src/seam.ts";
import { intrinsicsOfProjection, poseOfTransform, reprojection, Stance, viewpointOf } from "../../src/xr/views.ts";

let seed = 1;
/** From 0 to 1, the same in every run. */
function random(): number {
  seed = (seed * 1103515245 + 12345) % 2 ** 31;
  return seed / 2 ** 31;
}
const between = (low: number, high: number): number => low + (high - low) * random();
const vector = (size: number): Vec3 => [between(-size, size), between(-size, size), between(-size, size)];
const rotation = (): Quat => canonical([between(-1, 1), ...vector(1)]);
const near = (a: readonly number[], b: readonly number[], by = 1e-9): void =>
  a.forEach((part, i) => assert.ok(Math.abs(part - b[i]) <= by * Math.max(1, Math.abs(part)), `${a} is not ${b}`));

/** Tangents to the left, right, top and bottom, and WebGL's matrix of them. */
function frustum(): { matrix: number[]; tans: readonly [number, number, number, number] } {
  const tans = [between(0.3, 1.6), between(0.3, 1.6), between(0.3, 1.3), between(0.3, 1.3)] as const;
  const [n, f] = [0.1, 1000];
  const [l, r, t, b] = [-tans[0] * n, tans[1] * n, tans[2] * n, -tans[3] * n];
  const matrix = [
    [(2 * n) / (r - l), 0, 0, 0],
    [0, (2 * n) / (t - b), 0, 0],
    [(r + l) / (r - l), (t + b) / (t - b), -(f + n) / (f - n), -1],
    [0, 0, (-2 * f * n) / (f - n), 0],
  ].flat();
  return { matrix, tans };
}

/** A quaternion `wxyz` and place in WebXR's axes, as the transform that a browser gives. */
function transform([w, x, y, z]: Quat, [px, py, pz]: Vec3): Parameters<typeof poseOfTransform>[0] {
  return { position: { x: px, y: py, z: pz, w: 1 } as DOMPointReadOnly, orientation: { w, x, y, z } as DOMPointReadOnly };
}

/** Where a pinhole sees a point of its own space. */
const pixel = (i: Intrinsics, [x, y, z]: readonly number[]): [number, number] => [(i.fxPx * x) / z + i.cxPx, (i.fyPx * y) / z + i.cyPx];

/** World to camera. */
const seen = ({ position, rotation: q }: Pose, point: Vec3): Vec3 => turned(inverse(q), minus(point, position));

function eye(): Viewed {
  return { pose: { position: vector(2), rotation: rotation() }, intrinsics: intrinsicsOfProjection(frustum().matrix, 400, 300) };
}

test("an eye's pinhole sees every point where its projection matrix puts it, and its frustum is the picture", () => {
  for (let round = 0; round < 200; round++) {
    const { matrix: m, tans } = frustum();
    const [width, height] = [Math.round(between(16, 2000)), Math.round(between(16, 2000))];
    const intrinsics = intrinsicsOfProjection(m, width, height);
    const turn = rotation();
    const place = vector(3);
    const pose = poseOfTransform(transform(turn, place));
    const own: Vec3 = [between(-2, 2), between(-2, 2), -between(0.2, 20)]; // before the eye, in its axes
    const clip = [0, 1, 2, 3].map((row) => m[row] * own[0] + m[4 + row] * own[1] + m[8 + row] * own[2] + m[12 + row]);
    const wanted = [((clip[0] / clip[3] + 1) / 2) * width, ((1 - clip[1] / clip[3]) / 2) * height];
    near(pixel(intrinsics, seen(pose, plus(place, turned(turn, own)))), wanted, 1e-7);
    near(pixel(intrinsics, [-tans[0], -tans[2], 1]), [0, 0], 1e-7);
    near(pixel(intrinsics, [tans[1], tans[3], 1]), [width, height], 1e-7);
  }
});

test("the viewpoint is between the eyes, and sees all that they see, and no more than that", () => {
  for (let round = 0; round < 100; round++) {
    const head = rotation();
    const [right] = axesOf(head);
    const middle = vector(5);
    const eyes = [-0.03, 0.03].map((offset): Viewed => ({
      pose: { position: plus(middle, right, offset), rotation: head },
      intrinsics: intrinsicsOfProjection(frustum().matrix, 400, 300),
    }));
    const { pose, intrinsics } = viewpointOf(head, eyes);
    near(pose.position, middle);
    assert.deepEqual([intrinsics.cxPx, intrinsics.cyPx], [intrinsics.widthPx / 2, intrinsics.heightPx / 2]);
    const shares: number[][] = [];
    for (const { intrinsics: i } of eyes)
      for (const u of [0, i.widthPx])
        for (const v of [0, i.heightPx]) {
          const [x, y] = pixel(intrinsics, [(u - i.cxPx) / i.fxPx, (v - i.cyPx) / i.fyPx, 1]);
          shares.push([Math.abs(x / intrinsics.cxPx - 1), Math.abs(y / intrinsics.cyPx - 1)]);
        }
    for (const axis of [0, 1]) near([Math.max(...shares.map((share) => share[axis]))], [1]);
  }
});

test("a picture is shown where it was drawn, and as the head turns on where that now is", () => {
  for (let round = 0; round < 200; round++) {
    const [drawn, now] = [{ ...eye(), near: 0.1 } satisfies Camera, eye()];
    const across = now.intrinsics.widthPx;
    const at = [between(-1, 1), between(-1, 1), 1];
    const through = (h: readonly number[]): number[] => [0, 1, 2].map((row) => h[3 * row] * at[0] + h[3 * row + 1] * at[1] + h[3 * row + 2]);
    const itself = through(reprojection({ ...now, near: 0.1 }, now));
    near([itself[0] / itself[2], itself[1] / itself[2]], [(at[0] + 1) / 2, (1 - at[1]) / 2]);
    const i = now.intrinsics;
    const ray: Vec3 = [(((at[0] + 1) / 2) * across - i.cxPx) / i.fxPx, (((1 - at[1]) / 2) * i.heightPx - i.cyPx) / i.fyPx, 1];
    const away = turned(inverse(drawn.pose.rotation), turned(now.pose.rotation, ray));
    const [s, t, w] = through(reprojection(drawn, now));
    assert.equal(w > 0, away[2] > 0, "what is behind is not shown");
    if (Math.abs(away[2]) < 0.05) continue;
    near([(s / w) * drawn.intrinsics.widthPx, (t / w) * drawn.intrinsics.heightPx], pixel(drawn.intrinsics, away), 1e-6);
  }
});

test("a visitor stands upright where the camera is and faces where it faces, whatever the headset's space", () => {
  for (let round = 0; round < 200; round++) {
    const up = unit(vector(1));
    const stance = new Stance(up);
    const head: Pose = { position: vector(2), rotation: rotation() };
    const right = unit(cross(vector(1), up));
    const at: Pose = { position: vector(9), rotation: facing(right, up, between(-1.4, 1.4)) };
    stance.stand(head, at);
    const placed = stance.place(head);
    near(placed.position, at.position, 1e-7);
    near(up, minus(stance.place({ position: [0, 1, 0], rotation: head.rotation }).position, stance.place({ position: [0, 0, 0], rotation: head.rotation }).position), 1e-7);
    const [flat, wanted] = [placed, at].map(({ rotation: q }) => minus(axesOf(q)[2], scaled(up, dot(axesOf(q)[2], up))));
    if (length(flat) > 0.2 && length(wanted) > 0.2) near(unit(flat), unit(wanted), 1e-6);
    rotationMatrix(placed.rotation).flat().forEach((part) => assert.ok(Number.isFinite(part)));
  }
});

test("turning, growing and recentring keep the eyes in their place; a step is of the visitor's own metres", () => {
  const stance = new Stance([0, -1, 0]);
  const head: Pose = { position: [0.3, 1.6, -0.2], rotation: poseOfTransform(transform([1, 0, 0, 0], [0, 0, 0])).rotation };
  const at: Pose = { position: [1, 2, 3], rotation: [1, 0, 0, 0] };
  stance.stand(head, at);
  stance.turn(head, Math.PI / 2);
  near(stance.place(head).position, at.position);
  near(axesOf(stance.place(head).rotation)[2], [-1, 0, 0]); // from +Z to the left, the scene's up being -Y
  stance.grow(head, 4);
  near(stance.place(head).position, at.position);
  const other: Pose = { ...head, position: plus(head.position, [0.5, 0.2, 0.1]) };
  near([length(minus(stance.place(other).position, at.position))], [4 * Math.hypot(0.5, 0.2, 0.1)]);
  stance.move(head, 0, 1);
  near(stance.place(head).position, [1 - 4, 2, 3]);
  stance.move(head, 0.5, 0);
  near(stance.place(head).position, [1 - 4, 2, 3 + 2]);
  for (let i = 0; i < 20; i++) stance.grow(head, 4);
  assert.equal(stance.scale, 50);
});

/** A camera with this level direction to its right, that looks up or down by `pitch`. */
function facing(right: Vec3, up: Vec3, pitch: number): Quat {
  const forward = plus(scaled(cross(up, right), Math.cos(pitch)), up, Math.sin(pitch));
  return quaternionOf([right, cross(forward, right), forward]);
}
