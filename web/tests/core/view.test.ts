/** The author's view: read or refused as Python does, and the first view is the one that Python draws thumbnails of. */

import assert from "node:assert/strict";
import test from "node:test";
import { readManifest } from "../../src/decode/manifest.ts";
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
const near = (a: readonly number[], b: readonly number[]): boolean => a.every((part, i) => Math.abs(part - b[i]!) < 1e-5);

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
  const camera = new ViewCamera(read(bare));
  camera.home(0.6, 0.4);
  camera.turn(0.7, 0.2);
  camera.dolly(0.8);
  const saved = JSON.parse(savedView(read(bare), camera, "#102030")) as Record<string, unknown>;
  const scene = read({ ...bare, view: saved });
  assert.equal(titleOf(scene), "clip");
  assert.equal(scene.view.background, "#102030");
  const again = new ViewCamera(scene);
  again.home(0.6, 0.4);
  assert.ok(near(again.pose.position, camera.pose.position) && near(again.pose.rotation, camera.pose.rotation));
  again.turn(0.3, 0);
  camera.turn(0.3, 0);
  assert.ok(near(again.pose.position, camera.pose.position), "and turns around the same point");
});

test("an address says where to turn around and over what", () => {
  assert.deepEqual(placeOf("#target=1,2,3&background=A0b0c0"), { target: [1, 2, 3], background: "#A0b0c0" });
  assert.deepEqual(placeOf("#target=1,2&background=red"), {});
});
