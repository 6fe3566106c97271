import assert from "node:assert/strict";
import { test } from "node:test";
import { apart, validShare } from "../../src/playback/reach.ts";
import type { Pose, Vec3 } from "../../src/seam.ts";
import { vectors } from "./vectors.ts";

interface Case {
  poses: [Pose, Pose];
  centre: Vec3;
  radius: number;
  reach: number;
  apart: number;
  share: number;
}

test("as much of a reference is used as by Python's client", () => {
  const cases = vectors<Case[]>("cases");
  for (const { poses, centre, radius, reach, ...expected } of cases) {
    const distance = apart(...poses, centre, radius);
    assert.ok(Math.abs(distance - expected.apart) < 1e-9);
    assert.ok(Math.abs(validShare(distance, reach) - expected.share) < 1e-9);
  }
  assert.ok(cases.some(({ share }) => share > 0 && share < 1));
});
