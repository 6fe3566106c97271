import assert from "node:assert/strict";
import { test } from "node:test";
import { References } from "../../src/playback/references.ts";
import type { Reference } from "../../src/seam.ts";

const CLIP = 90;

/** What a frame on display gets. */
function shown<P>(references: References<P>, frame: number, maxAge = 0): P | undefined {
  references.show(frame, CLIP);
  return references.newest(maxAge)?.picture;
}

function basisOf<P>(references: References<P>, frame: number): number | undefined {
  references.show(frame, CLIP);
  return references.basis(undefined);
}

function silent(frame: number, order: number, basis: number): Reference {
  return { frame, order, basis, kind: "nothing" } as unknown as Reference;
}

for (const skipped of [19, 8]) {
  test(`a reference of frame ${skipped}, which was skipped, holds nothing back at frame 20`, () => {
    const references = new References<null>();
    references.marked(9);
    references.add(silent(skipped, 1, 4), null);
    assert.equal(basisOf(references, 20), 9);
  });
}

test("while the clip stands still, references of later frames hold nothing back", () => {
  const references = new References<null>();
  references.marked(9);
  references.add(silent(21, 1, 4), null);
  assert.equal(basisOf(references, 20), 4);
  assert.equal(references.basis(undefined, true), 9);
});

test("in a loop the next references are of the clip's first frames", () => {
  const references = new References<null>();
  references.marked(9);
  references.add(silent(2, 1, 4), null);
  assert.equal(basisOf(references, 88), 4);
  assert.equal(basisOf(references, 3), 9);
});

test("a reference of a frame that was skipped holds nothing back, nor half a clip later", () => {
  const references = new References<null>();
  references.marked(9);
  references.add(silent(1, 1, 4), null);
  for (let frame = 2; frame < 3 * CLIP; frame += 2) assert.equal(basisOf(references, frame % CLIP), 9);
});

test("references that greeted are forgotten, decoded late too; those after them stay", () => {
  const references = new References<string>();
  for (const [frame, order] of [[0, 1], [3, 2]] as const) references.add(silent(frame, order, 4), `of ${frame}`);
  references.reset(1);
  references.add(silent(1, 1, 4), "late");
  assert.equal(shown(references, 2, 10), undefined);
  assert.equal(shown(references, 4, 10), "of 3");
  references.reset();
  references.add(silent(5, 3, 4), "of 5");
  assert.deepEqual([shown(references, 4, 10), shown(references, 6, 10)], [undefined, "of 5"]);
});

test("a play has a beginning, and another one after a jump, but not where the reference of the pause is forgotten", () => {
  const references = new References<string>();
  const begins = (frame: number): boolean => {
    references.show(frame, CLIP);
    return references.beginning;
  };
  assert.equal(references.beginning, false);
  assert.deepEqual([3, 14, 15].map(begins), [true, true, false]);
  references.reset(1);
  assert.equal(begins(16), false);
  references.reset();
  assert.deepEqual([16, 27, 28, 2].map(begins), [true, true, false, false]);
});

test("a round of a loop shows no reference of the round before, and those of its own that came early", () => {
  const references = new References<string>();
  for (let frame = 0; frame < 4; frame++) {
    references.add(silent(frame, frame + 1, 4), `first ${frame}`);
    assert.equal(shown(references, frame), `first ${frame}`);
  }
  for (let frame = 4; frame < CLIP - 2; frame++) shown(references, frame);
  references.add(silent(1, 9, 5), "second 1");
  for (let frame = CLIP - 2; frame < 2 * CLIP; frame++) {
    assert.equal(shown(references, frame % CLIP), frame === CLIP + 1 ? "second 1" : undefined, `frame ${frame}`);
  }
});

test("a reference that came after its own frame is shown with what it assumes, and nothing falls back", () => {
  const references = new References<null>();
  const basis = (frame: number): number | undefined => {
    references.show(frame, CLIP);
    return references.basis(references.newest(9));
  };
  const differs = (frame: number, order: number, mark: number): Reference =>
    ({ frame, order, basis: mark, kind: "difference" }) as unknown as Reference;
  references.marked(9);
  references.add(differs(10, 1, 4), null);
  assert.equal(basis(10), 4);
  assert.equal(basis(11), 4);
  references.add(differs(11, 2, 6), null);
  assert.equal(basis(12), 6);
  references.add(differs(10, 3, 5), null);
  assert.equal(basis(13), 6);
});

test("while a reference is late, one that says nothing holds nothing back", () => {
  const references = new References<null>();
  references.marked(9);
  references.add(silent(10, 1, 4), null);
  for (const [frame, mark] of [[10, 4], [11, 9]] as const) {
    references.show(frame, CLIP);
    assert.equal(references.basis(references.newest(9)), mark);
  }
});
