import assert from "node:assert/strict";
import { test } from "node:test";
import { Changes } from "../../src/source/changes.ts";

const camera = {
  intrinsics: { widthPx: 128, heightPx: 64, fxPx: 60, fyPx: 60, cxPx: 64, cyPx: 32 },
  pose: { position: [0, 0, 0], rotation: [1, 0, 0, 0] },
  near: 0.01,
} as never;
const SIZES = new Float32Array(6).fill(-4);
const at = (shift: number): Float32Array => new Float32Array([-1 + shift, 0, 4, 1 + shift, 0, 4]);

function shown(mark: number, ...rows: number[]): Changes {
  const changes = new Changes();
  changes.shown(10, at(0));
  changes.committed(mark, Int32Array.from(rows));
  return changes;
}

function count(changes: Changes, basis: number | undefined, means: Float32Array): number {
  const since = basis === undefined ? { frame: 10, camera, focalPx: 60 } : { frame: 10, basis, camera, focalPx: 60 };
  return changes.since(since, means, SIZES).radii.length;
}

test("motion that a difference assumes takes its correction along", () => {
  assert.equal(count(shown(1), 1, at(1)), 0);
  assert.equal(count(shown(1), undefined, at(1)), 2, "of a picture, what has moved counts");
});

test("where more is shown than a difference assumes, what has moved counts", () => {
  const changes = shown(2);
  assert.equal(count(changes, 1, at(1)), 2);
  changes.committed(1, new Int32Array());
  assert.equal(count(changes, 1, at(1)), 0);
});

test("what was changed counts for a difference from before, and never for a picture", () => {
  const changes = shown(2, 1);
  assert.equal(count(changes, 1, at(0)), 1);
  assert.equal(count(changes, 2, at(0)), 0);
  assert.equal(count(changes, undefined, at(0)), 0);
});
