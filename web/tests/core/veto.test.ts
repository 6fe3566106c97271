import assert from "node:assert/strict";
import { test } from "node:test";
import { cellBoxes } from "../../src/player/veto.ts";
import type { Camera } from "../../src/seam.ts";
import { fromBase64, vectors } from "./vectors.ts";

interface Case {
  camera: Camera;
  positions: string;
  radii: string;
  boxes: number[];
}

const floats = (text: string): Float32Array => new Float32Array(fromBase64(text).slice().buffer);

test("cells that changed splats may cover are Python's", () => {
  const cases = vectors<Case[]>("cases");
  for (const { camera, positions, radii, boxes } of cases) {
    assert.deepEqual([...cellBoxes(floats(positions), floats(radii), camera)], boxes);
  }
  assert.ok(cases.some(({ boxes }) => boxes.length > 40));
});
