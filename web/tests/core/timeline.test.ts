import assert from "node:assert/strict";
import { test } from "node:test";
import { frameAt, Timeline } from "../../src/wire/timeline.ts";
import { vectors } from "./vectors.ts";

interface Vector {
  readonly name: string;
  readonly timeline: { fps: number; frames: number; frame: number; at_us: number; rate: number; playing: boolean; loop: boolean };
  readonly ticks: readonly (readonly [number, number, number | null])[];
  readonly first_ticks: readonly (readonly [number, number])[];
}

for (const { name, timeline: given, ticks, first_ticks } of vectors<Vector[]>("timeline")) {
  test(name, () => {
    const { fps, frames, frame, at_us: atUs, rate, playing, loop } = given;
    const timeline = new Timeline(fps, frames, { frame, atUs, rate, playing, loop });
    for (const [tick, displayUs, shown] of ticks) {
      assert.deepEqual([timeline.displayUs(tick), timeline.mediaFrame(tick)], [displayUs, shown], `tick ${tick}`);
    }
    for (const [fromUs, tick] of first_ticks) assert.equal(timeline.firstTick(fromUs), tick, `from ${fromUs}`);
  });
}

test("a control makes a new timeline; rounds end with the last frame", () => {
  const timeline = new Timeline(30, 10).controlled({ action: "play", frame: 8, atUs: 5, rate: 2, loop: true });
  assert.deepEqual([0, 1, 2, 3].map((tick) => timeline.mediaFrame(tick)), [8, 9, 0, 1]);
  assert.deepEqual([0, 1, 2, 12].map((tick) => timeline.roundEnd(tick)), [2, 2, 12, 22]);
  const sought = timeline.controlled({ action: "seek", frame: 99, atUs: 7 });
  assert.deepEqual(sought.place, { frame: 9, atUs: 7, rate: 1, playing: true, loop: false });
  assert.equal(sought.controlled({ action: "pause", frame: 3, atUs: 8 }).mediaFrame(5), 3);
});

test("moments of links lead to the frames that they were copied from, and to none beyond the end", () => {
  for (const fps of [5, 10, 24, 29.97, 30, 60, 90]) {
    for (let frame = 0; frame < 400; frame++) {
      assert.equal(frameAt(Number((frame / fps).toFixed(4)), { fps, frames: 400 }), frame, `${frame} at ${fps}`);
    }
  }
  const clip = { fps: 10, frames: 20 };
  assert.deepEqual([1.5, 1.59, 2, 100, 1e300, -1].map((seconds) => frameAt(seconds, clip)), [15, 15, 19, 19, 19, 0]);
});
