import assert from "node:assert/strict";
import { test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import type { Renderer } from "../../src/gpu/renderer.ts";
import { Player } from "../../src/player/player.ts";
import { type FrameRequest, type FrameUpdate, type Intrinsics, nowUs, type PlayState, type Pose, type SceneInfo, type SceneSource } from "../../src/seam.ts";

const FPS = 100;
const FRAMES = 60;
const POSE: Pose = { position: [0, 0, 0], rotation: [1, 0, 0, 0] };
const INTRINSICS: Intrinsics = { widthPx: 16, heightPx: 12, fxPx: 9, fyPx: 9, cxPx: 8, cyPx: 6 };
const INFO = {
  name: "x", fps: FPS, frames: FRAMES, gofStarts: [0], capacity: [1], shDegree: 0, bounds: [[0, 0, 0], [1, 1, 1]], lods: 1,
  codec: "svq", up: [0, 1, 0], focusCentre: [0, 0, 0], focusRadius: 1, near: 0.1, moves: false, manifest: {},
} as const;

class Source implements SceneSource {
  readonly told: PlayState[] = [];
  readonly asked: FrameRequest[] = [];
  connect(): void {}
  control(state: PlayState): void {
    this.told.push(state);
  }
  keeps(): boolean {
    return true;
  }
  sendPoses(): void {}
  requestKeyframe(): void {}
  frame(request: FrameRequest): Promise<FrameUpdate> {
    this.asked.push(request);
    const { frame } = request;
    return Promise.resolve({ frame, share: 0, patches: [], full: true, missed: false, mark: 0, shDegree: 0 } as unknown as FrameUpdate);
  }
  close(): void {}
}

/** A page whose pictures cost nothing; it says what came, and steps as a screen does. */
class Page {
  readonly source = new Source();
  readonly player: Player;
  readonly seen: number[] = [];
  constructor(waits: boolean, prepared: Promise<unknown> = Promise.resolve()) {
    const renderer = { prepared, gpu: { lost: false }, update: () => {}, draw: () => Promise.resolve({ gpuMs: 0 }) } as unknown as Renderer;
    const options = { startFrame: 0, playing: true, loop: false, adaptResolution: false, exactness: "fast", correct: true } as const;
    const events = { changed: () => {}, info: () => {}, failed: (error: unknown) => assert.fail(JSON.stringify(error)), notice: () => {} };
    this.player = new Player(this.source, renderer, () => ({ pose: POSE, intrinsics: INTRINSICS }), options, events);
    this.player.handle({ type: "info", info: { ...INFO, waits } as unknown as SceneInfo });
  }

  whole(...frames: number[]): void {
    for (const frame of frames) this.player.handle({ type: "whole", frame, mark: 0 });
  }

  async until(what: string, found: () => boolean): Promise<void> {
    const ends = nowUs() + 10e6;
    while (!found()) {
      assert.ok(nowUs() < ends, `${what} did not come`);
      this.player.step();
      if (this.player.shown) this.seen.push(this.player.shown.frame);
      await sleep(1);
    }
  }
}

const upTo = (end: number, first = 0): number[] => Array.from({ length: end - first }, (_, i) => first + i);

test("a play whose data comes as it may waits for it, and goes on where it stopped", async () => {
  const page = new Page(true);
  page.whole(...upTo(20));
  await page.until("a stall", () => page.player.stalls === 1);
  const { frame } = page.player;
  assert.equal(frame, 20, "the first that is not there");
  assert.ok(page.player.waiting);
  page.whole(...upTo(40, 21), ...upTo(59, 41)); // not 20, nor 40
  page.whole(20);
  assert.ok(page.player.waiting, "a second of play is to be there");
  const told = page.source.told.length;
  page.whole(40, 59);
  assert.deepEqual(page.source.told.slice(told).map(({ action, frame: at }) => [action, at]), [["play", 20]]);
  await page.until("the end", () => page.player.shown?.frame === FRAMES - 1);
  assert.equal(page.player.stalls, 1);
  assert.ok(page.player.stalledMs > 0);
  assert.ok(page.seen.every((at, i) => !i || at >= page.seen[i - 1]!), "no frame is shown twice");
});

test("a live play goes on without what is late", async () => {
  const page = new Page(false);
  page.whole(...upTo(20));
  await page.until("the end", () => page.player.shown?.frame === FRAMES - 1);
  assert.equal(page.player.stalls, 0);
});

test("pausing and seeking while data is waited for", async () => {
  const page = new Page(true);
  page.whole(...upTo(10));
  await page.until("a stall", () => page.player.stalls === 1);
  page.player.pause();
  page.whole(...upTo(FRAMES, 10));
  assert.ok(!page.player.waiting);
  await page.until("the frame", () => page.player.shown?.frame === 10);
  page.player.handle({ type: "flushed" });
  page.player.seek(30);
  page.player.step();
  assert.ok(page.player.waiting, "it has not come again");
  page.whole(...upTo(FRAMES, 10));
  await page.until("the place", () => page.player.shown?.frame === 30);
  assert.equal(page.player.stalls, 1);
});

test("nothing is played before the shaders are there", async () => {
  let ready = (): void => {};
  const page = new Page(false, new Promise<void>((resolve) => (ready = resolve)));
  page.whole(0);
  page.player.step();
  await sleep(5);
  assert.deepEqual([page.source.told.length, page.source.asked.length], [0, 0]);
  ready();
  await page.until("a picture", () => page.player.shown !== null);
  assert.deepEqual(page.source.told.map(({ action }) => action), ["play"]);
});
