import assert from "node:assert/strict";
import { test } from "node:test";
import { References } from "../../src/playback/references.ts";
import type { Reference } from "../../src/seam.ts";

const CLIP = 90;

function silent(frame: number, order: number, basis: number): Reference {
  return { frame, order, basis, kind: "nothing" } as unknown as Reference;
}

for (const skipped of [19, 8]) {
  test(`a reference of frame ${skipped}, which was skipped, holds nothing back at frame 20`, () => {
    const references = new References<null>();
    references.marked(9);
    references.add(silent(skipped, 1, 4), null);
    assert.equal(references.basisAt(20, undefined, CLIP), 9);
  });
}

test("in a loop the next references are of the clip's first frames", () => {
  const references = new References<null>();
  references.marked(9);
  references.add(silent(2, 1, 4), null);
  assert.equal(references.basisAt(88, undefined, CLIP), 4);
  assert.equal(references.basisAt(3, undefined, CLIP), 9);
});

test("a reference of a frame that was skipped holds nothing back, nor half a clip later", () => {
  const references = new References<null>();
  references.marked(9);
  references.add(silent(1, 1, 4), null);
  for (let frame = 2; frame < 3 * CLIP; frame += 2) assert.equal(references.basisAt(frame % CLIP, undefined, CLIP), 9);
});

test("references that greeted are forgotten, decoded late too; those after them stay", () => {
  const references = new References<string>();
  for (const [frame, order] of [[0, 1], [3, 2]] as const) references.add(silent(frame, order, 4), `of ${frame}`);
  references.reset(1);
  references.add(silent(1, 1, 4), "late");
  assert.equal(references.newest(2, 10), undefined);
  assert.equal(references.newest(4, 10)?.picture, "of 3");
  references.reset();
  references.add(silent(5, 3, 4), "of 5");
  assert.deepEqual([references.newest(4, 10), references.newest(6, 10)?.picture], [undefined, "of 5"]);
});
