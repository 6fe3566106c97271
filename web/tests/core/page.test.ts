/** What anybody may write into an address, send to the page, or do to its window; and what the page says of its picture. */

import assert from "node:assert/strict";
import test from "node:test";
import { headingsOf } from "../../src/page/author.ts";
import { acts } from "../../src/page/bar.ts";
import { verdictOf } from "../../src/page/light.ts";
import { givenPose, placeOf } from "../../src/page/place.ts";
import { anglesOf, intrinsicsOf, MOST_PIXELS, pixelsOf, usableSize } from "../../src/page/view.ts";
import type { Player } from "../../src/player/player.ts";
import { nowUs } from "../../src/seam.ts";

const HALF_DEGREE_RAD = Math.PI / 360;

test("an address says where and when a visit begins, and nonsense in it says nothing", () => {
  const good = placeOf("#t=1.5&pose=1,2,3,2,0,0,0&target=0,0,9");
  assert.deepEqual(good, { seconds: 1.5, pose: { position: [1, 2, 3], rotation: [1, 0, 0, 0] }, target: [0, 0, 9] });
  for (const odd of ["t=NaN", "t=1e99", "t=1e999", "t=", "pose=1e300,0,0,1,0,0,0", "pose=0,0,0,0,0,0,0", "pose=0,0,0,1e200,1e200,0,0", "pose=1,2", "target=1e30,0,0"]) {
    const { seconds, ...place } = placeOf(`#${odd}`);
    assert.deepEqual([seconds ?? 0, place], [0, {}], odd);
  }
});

test("a pose that a page around this one sends is seven numbers, or none", () => {
  assert.deepEqual(givenPose([0, 0, -3, 1, 0, 0, 0]), { position: [0, 0, -3], rotation: [1, 0, 0, 0] });
  for (const odd of [null, "pose", [0, 0, 0], [1e10, 0, 0, 1, 0, 0, 0], [0, 0, 0, 0, 0, 0, 0], [0, 0, 0, "1", 0, 0, 0], [0, 0, 0, NaN, 0, 0, 0]]) {
    assert.equal(givenPose(odd), undefined, JSON.stringify(odd));
  }
});

test("no size that an address asks for is more than is drawn, and its shape stays", () => {
  const { size } = placeOf("#size=9999x9999");
  const [width, height] = pixelsOf(900, 700, 1, size);
  assert.ok(width * height <= 1.001 * MOST_PIXELS && width === height);
  assert.deepEqual(pixelsOf(900, 700, 2, [640, 480]), [640, 480]);
  assert.ok(pixelsOf(900, 700, 1, [9999, 16])[0] <= 8192);
});

test("a window that is folded away has no size, and one that is a sliver a view that servers draw", () => {
  for (const [width, height] of [[0, 0], [300, 0], [2000, 1], [15, 900]] as const) assert.equal(usableSize(width, height), undefined);
  for (const [width, height] of [[16, 16], [900, 700], [4000, 16], [16, 4000], [8000, 17]] as const) {
    assert.deepEqual(usableSize(width, height), [width, height]);
    const pixels = pixelsOf(width, height, 1);
    const pinhole = intrinsicsOf(...pixels, anglesOf(...pixels));
    const angles = [pinhole.widthPx / pinhole.fxPx, pinhole.heightPx / pinhole.fyPx].map((side) => 2 * Math.atan(side / 2));
    assert.ok(Math.min(...angles) > HALF_DEGREE_RAD && Math.max(...angles) < 0.9 * Math.PI, `${width}x${height}: ${angles}`);
  }
  const { tanX, tanY } = anglesOf(900, 700);
  assert.ok(Math.abs(tanX - Math.tan(Math.PI / 6)) < 1e-12 && Math.abs(tanY / tanX - 7 / 9) < 1e-12);
});

test("a key that is held acts once, but for those that step through the frames", () => {
  const held = (code: string): boolean => acts({ code, repeat: true });
  assert.deepEqual(["Space", "KeyR", "KeyF", "KeyI", "KeyV", "Comma", "Period"].map(held), [false, false, false, false, false, true, true]);
  assert.ok(acts({ code: "Space", repeat: false }));
});

test("scenes of one title can be told apart", () => {
  const scenes = [["a", "procedural"], ["b", "procedural"], ["vase", "Vase"], ["procedural", "procedural"]].map(([name, title]) => ({ name: name!, title: title! }));
  assert.deepEqual(headingsOf(scenes), ["procedural (a)", "procedural (b)", "Vase", "procedural"]);
});

test("the light is not green over a picture without any splats", () => {
  const player = (lodMean: number): Player =>
    ({
      info: { lods: 3 }, status: { link: "open", references: false }, waiting: false, playing: true, cadencePermille: 1000, scale: 1,
      shown: { update: { missed: false, lodMean }, atUs: nowUs() },
    }) as unknown as Player;
  assert.deepEqual(verdictOf(player(2)).state, "good");
  assert.deepEqual(verdictOf(player(NaN)), { state: "fair", text: "nothing in view" });
});
