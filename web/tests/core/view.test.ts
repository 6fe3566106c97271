/** The author's view: read or refused as Python does, and the first view is the one that Python draws thumbnails of. */

import assert from "node:assert/strict";
import test from "node:test";
import { readManifest, sceneInfo } from "../../src/decode/manifest.ts";
import { savedView, titleOf } from "../../src/page/author.ts";
import { placeOf } from "../../src/page/place.ts";
import { ViewCamera } from "../../src/player/camera.ts";
import { vectors } from "./vectors.ts";

interface Case {
  readonly manifest: Record<string, unknown>;
  readonly tangents: readonly [number, number];
  /** Position and quaternion. */
  readonly pose: readonly number[];
}
const read = (table: unknown): ReturnType<typeof readManifest> => readManifest(new TextEncoder().encode(JSON.stringify(table)));
const near = (a: readonly number[], b: readonly number[]): boolean => a.every((part, i) => Math.abs(part - b[i]!) < 3e-5);

test("first views are Python's", () => {
  for (const { manifest, tangents, pose } of vectors<Case[]>("cases")) {
    const camera = new ViewCamera(read(manifest));
    camera.home(...tangents);
    const found = [...camera.pose.position, ...camera.pose.rotation];
    assert.ok(near(found, pose), `${JSON.stringify(manifest["view"])}: ${found} is not ${pose}`);
  }
});

test("hostile values are refused", () => {
  const { bare, faults } = vectors<{ bare: Record<string, unknown>; faults: [string, unknown][] }>("hostile");
  for (const [name, value] of faults) {
    assert.throws(() => read({ ...bare, view: { [name]: value } }), new RegExp(`^[^\n]*manifest: view.${name}[^\n]*$`), JSON.stringify(value));
  }
  assert.throws(() => read({ ...bare, view: [] }), /view must be an object/);
});

test("what the page saves is what a manifest takes, and gives the same view again", () => {
  const { bare } = vectors<{ bare: Record<string, unknown> }>("hostile");
  const shapes: readonly (readonly [number, number])[] = [[0.6, 0.4], [0.6, 0.2], [0.25, 0.6]];
  for (const tangents of shapes) {
    const first = read({ ...bare, view: { background: "#102030" } });
    const camera = new ViewCamera(first);
    camera.home(...tangents);
    camera.turn(0.7, 0.2);
    camera.dolly(0.8);
    const saved = JSON.parse(savedView(sceneInfo(first, false), camera, ...tangents)) as Record<string, unknown>;
    const scene = read({ ...bare, view: saved });
    assert.equal(titleOf(scene), "clip");
    assert.equal(scene.view.background, "#102030");
    const again = new ViewCamera(scene);
    again.home(...tangents);
    assert.ok(near(again.pose.position, camera.pose.position) && near(again.pose.rotation, camera.pose.rotation));
    again.turn(0.3, 0);
    camera.turn(0.3, 0);
    assert.ok(near(again.pose.position, camera.pose.position), "and turns around the same point");
  }
});

test("in a narrower picture than the author's as much is seen, from farther back", () => {
  const { bare } = vectors<{ bare: Record<string, unknown> }>("hostile");
  const scene = read({ ...bare, view: { pose: [0, 0, -4, 0, 0, 0, 1], target: [0, 0, 0] } });
  const camera = new ViewCamera(scene);
  camera.home(0.57735, 0.18042); // half of the author's height
  assert.ok(Math.abs(camera.pose.position[2] + 8) < 1e-3);
  camera.home(0.6, 0.5);
  assert.ok(Math.abs(camera.pose.position[2] + 4) < 1e-9);
});

test("an address says where to turn around and over what", () => {
  assert.deepEqual(placeOf("#target=1,2,3&background=A0b0c0"), { target: [1, 2, 3], background: "#A0b0c0" });
  assert.deepEqual(placeOf("#target=1,2&background=red"), {});
});
