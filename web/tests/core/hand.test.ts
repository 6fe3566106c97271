/** Where what is seen goes when a hand drags it, and where the view turns on keys and sticks: in every mode of the camera. */

import assert from "node:assert/strict";
import test from "node:test";
import { MODES, ViewCamera } from "../../src/player/camera.ts";
import { Gestures } from "../../src/player/gestures.ts";
import { axesOf, dot, minus, plus } from "../../src/player/vectors.ts";
import type { Vec3 } from "../../src/seam.ts";

const UPS: readonly Vec3[] = [[0, -1, 0], [0, 1, 0], [0, 0, 1], [0.6, 0, -0.8]];

/** As much of the picture's element as gestures ask of it. */
class Picture extends EventTarget {
  readonly clientHeight = 400;
  setPointerCapture(): void {}
}

let pads: { axes: number[] }[] = [];
Object.assign(globalThis, { addEventListener: () => undefined });
Object.defineProperty(globalThis, "navigator", { configurable: true, value: { getGamepads: () => pads } });

function visit(up: Vec3, mode: (typeof MODES)[number]): { camera: ViewCamera; gestures: Gestures; picture: Picture } {
  const picture = new Picture();
  const camera = new ViewCamera({ up, focusCentre: [1, 2, 3], focusRadius: 1, bounds: [[0, 1, 2], [2, 3, 4]], view: {} });
  const gestures = new Gestures(picture as unknown as HTMLElement, () => undefined);
  camera.home(0.5, 0.4);
  camera.mode = mode;
  gestures.drive(camera);
  gestures.step(0);
  return { camera, gestures, picture };
}

/** Whither a point in front of the target goes in the picture: right and down. */
function shift(camera: ViewCamera, act: () => void): readonly [number, number] {
  const { target } = camera.around;
  const point = plus(target, minus(camera.pose.position, target), 0.2);
  const at = (): readonly [number, number] => {
    const { position, rotation } = camera.pose;
    const [x, y, z] = axesOf(rotation);
    const way = minus(point, position);
    return [dot(way, x) / dot(way, z), dot(way, y) / dot(way, z)];
  };
  const before = at();
  act();
  const after = at();
  return [after[0] - before[0], after[1] - before[1]];
}

function pointer(picture: Picture, kind: string, id: number, x: number, y: number, shiftKey = false): void {
  picture.dispatchEvent(Object.assign(new Event(kind), { pointerId: id, clientX: x, clientY: y, shiftKey, buttons: 1 }));
}

/** It goes this way, and little any other. */
function goes(found: readonly [number, number], [right, down]: readonly [number, number], what: string): void {
  const along = found[0] * right + found[1] * down;
  const across = found[0] * down - found[1] * right;
  assert.ok(along > 0.002 && Math.abs(across) < 0.2 * along, `${what}: ${found.join(", ")}`);
}

const WAYS = { Right: [1, 0], Left: [-1, 0], Down: [0, 1], Up: [0, -1] } as const;
const flipped = ([right, down]: readonly [number, number]): readonly [number, number] => [-right, -down];

for (const mode of MODES) {
  test(`${mode}: a drag takes what is seen with it, with one finger, with two and with shift`, () => {
    for (const up of UPS)
      for (const [name, way] of Object.entries(WAYS)) {
        for (const shiftKey of [false, true]) {
          const { camera, picture } = visit(up, mode);
          const moved = shift(camera, () => {
            pointer(picture, "pointerdown", 1, 200, 200, shiftKey);
            pointer(picture, "pointermove", 1, 200 + 9 * way[0], 200 + 9 * way[1], shiftKey);
            pointer(picture, "pointerup", 1, 200 + 9 * way[0], 200 + 9 * way[1], shiftKey);
          });
          goes(moved, way, `${name}${shiftKey ? " with shift" : ""}`);
        }
        const { camera, picture } = visit(up, mode);
        const moved = shift(camera, () => {
          for (const id of [1, 2]) pointer(picture, "pointerdown", id, 100 * id, 200);
          for (const id of [1, 2]) pointer(picture, "pointermove", id, 100 * id + 9 * way[0], 200 + 9 * way[1]);
        });
        goes(moved, way, `${name} with two fingers`);
      }
  });

  test(`${mode}: arrows and the right stick turn the view that way, or what is orbited`, () => {
    for (const up of UPS)
      for (const [name, way] of Object.entries(WAYS)) {
        const wanted = mode === "orbit" ? way : flipped(way); // what is seen goes against a view that turns
        const keys = visit(up, mode);
        const key = { code: `Arrow${name}`, ctrlKey: false, metaKey: false, altKey: false } as KeyboardEvent;
        goes(shift(keys.camera, () => void keys.gestures.key(key, true)), wanted, `Arrow${name}`);
        const stick = visit(up, mode);
        pads = [{ axes: [0, 0, ...way] }];
        goes(shift(stick.camera, () => stick.gestures.step(50)), wanted, `stick ${name}`);
        pads = [];
      }
  });
}

test("what is placed at a pose stands there, however it was turned to it", () => {
  for (const up of UPS) {
    const { camera } = visit(up, "fly");
    camera.turn(0.7, 0.3);
    const { pose } = camera;
    const { camera: other } = visit(up, "fly");
    other.place(pose);
    [...other.pose.position, ...other.pose.rotation].forEach((part, i) => {
      assert.ok(Math.abs(part - [...pose.position, ...pose.rotation][i]!) < 1e-9);
    });
  }
});
