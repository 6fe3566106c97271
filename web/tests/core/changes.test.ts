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
  committed(changes, 10, mark, rows, 0);
  return changes;
}

/** `rows` change with `frame` by what begins in frame `began`. */
function committed(changes: Changes, frame: number, mark: number, rows: number[], began: number): void {
  changes.committed(frame, mark, Int32Array.from(rows), new Int32Array(rows.length).fill(began));
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
  committed(changes, 10, 1, [], 0);
  assert.equal(count(changes, 1, at(1)), 0);
});

test("what was refined counts for a difference from before, and never for a picture", () => {
  const changes = shown(2, 1);
  assert.equal(count(changes, 1, at(0)), 1);
  assert.equal(count(changes, 2, at(0)), 0);
  assert.equal(count(changes, undefined, at(0)), 0);
});

test("looks that begin after a reference's frame count for every reference, until the play goes back", () => {
  const changes = shown(1);
  committed(changes, 11, 1, [1], 11);
  assert.equal(count(changes, 1, at(0)), 1);
  assert.equal(count(changes, undefined, at(0)), 1);
  committed(changes, 3, 1, [], 0);
  assert.equal(count(changes, 1, at(0)), 0);
});
