import assert from "node:assert/strict";
import { test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import type { Renderer } from "../../src/gpu/renderer.ts";
import { Player, type PlayerOptions } from "../../src/player/player.ts";
import { type FrameRange, type FrameRequest, type FrameUpdate, type Intrinsics, NO_FRAMES, nowUs, type PlayState, type Pose, type Reference, type SceneInfo, type SceneSource, type SourceError } from "../../src/seam.ts";

const FPS = 100;
const FRAMES = 60;
const POSE: Pose = { position: [0, 0, 0], rotation: [1, 0, 0, 0] };
const INTRINSICS: Intrinsics = { widthPx: 16, heightPx: 12, fxPx: 9, fyPx: 9, cxPx: 8, cyPx: 6 };
const INFO = {
  name: "x", fps: FPS, frames: FRAMES, gofStarts: [0], capacity: [1], keptWhole: true, shDegree: 0, bounds: [[0, 0, 0], [1, 1, 1]], lods: 1,
  codec: "svq", up: [0, 1, 0], focusCentre: [0, 0, 0], focusRadius: 1, near: 0.1, moves: false, manifest: {},
} as const;

class Source implements SceneSource {
  readonly told: PlayState[] = [];
  readonly asked: FrameRequest[] = [];
  closed = 0;
  kept: FrameRange = [0, Infinity];
  connect(): void {}
  control(state: PlayState): void {
    this.told.push(state);
  }
  sendPoses(): void {}
  requestKeyframe(): void {}
  reshape(): void {}
  frame(request: FrameRequest): Promise<FrameUpdate> {
    this.asked.push(request);
    const { frame } = request;
    return Promise.resolve({ frame, share: 0, patches: [], full: true, missed: false, mark: 0, shDegree: 0 } as unknown as FrameUpdate);
  }
  close(): void {
    this.closed += 1;
  }
}

/** A page whose pictures take `drawMs`, nothing at first; it says what came, and steps as a screen does. */
class Page {
  readonly source = new Source();
  readonly player: Player;
  readonly seen: number[] = [];
  readonly errors: SourceError[] = [];
  drawMs = 0;
  uploads = 0;
  broken = false;
  constructor(waits: boolean, prepared: Promise<unknown> = Promise.resolve(), made: Promise<void> = Promise.resolve(), chosen: Partial<PlayerOptions> = {}) {
    const draw = async (): Promise<object> => {
      if (this.drawMs) await sleep(this.drawMs);
      if (this.broken) throw new Error("no memory");
      return { gpuMs: this.drawMs };
    };
    const renderer = made.then(() => ({ prepared, gpu: { lost: false }, update: () => void this.uploads++, draw }) as unknown as Renderer);
    const options = { startSeconds: 0, playing: true, loop: false, rate: 1, adaptResolution: true, exactness: "fast", correct: true, ...chosen } as const;
    const events = { changed: () => {}, info: () => {}, failed: (error: SourceError) => void this.errors.push(error), notice: () => {} };
    this.player = new Player(this.source, renderer, () => ({ pose: POSE, intrinsics: INTRINSICS }), options, events);
    this.player.handle({ type: "info", info: { ...INFO, waits } as unknown as SceneInfo });
  }

  get actions(): string[] {
    return this.source.told.map(({ action }) => action);
  }

  whole(...frames: number[]): void {
    for (const frame of frames) this.player.handle({ type: "whole", frame, mark: 0 });
  }

  async until(what: string, found: () => boolean): Promise<void> {
    const ends = nowUs() + 10e6;
    while (!found()) {
      assert.ok(nowUs() < ends, `${what} did not come; ${JSON.stringify(this.errors)}`);
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

test("a device that falls behind passes over no frame that is not there", async () => {
  const page = new Page(true);
  page.whole(...upTo(20), ...upTo(40, 23));
  page.drawMs = 40; // over one frame
  await page.until("a stall", () => page.player.stalls === 1);
  assert.equal(page.player.frame, 20);
});

test("a live play goes on without what is late", async () => {
  const page = new Page(false);
  page.whole(...upTo(20));
  await page.until("the end", () => page.player.shown?.frame === FRAMES - 1);
  assert.equal(page.player.stalls, 0);
});

test("a clip that is held goes round without a word, and at the speed that was wished at the last moment", async () => {
  const page = new Page(true);
  page.player.setLoop(true);
  page.whole(...upTo(FRAMES));
  await page.until("the last frame", () => page.player.shown?.frame === FRAMES - 1);
  const told = page.source.told.length;
  await page.until("the next round", () => page.player.shown?.frame === 5);
  assert.equal(page.source.told.length, told);
  await page.until("its last frame", () => page.player.shown?.frame === FRAMES - 1);
  page.player.setRate(2);
  await page.until("the round after", () => page.player.shown?.frame === 5);
  assert.equal(page.source.told.at(-1)!.rate, 2);
});

test("a play that a server took over goes on where it stood", async () => {
  const page = new Page(false);
  page.whole(0);
  await page.until("a frame", () => (page.player.shown?.frame ?? 0) >= 5);
  const from = page.player.shown!.frame;
  const { frame, atUs } = page.source.told.findLast(({ action }) => action === "play")!;
  assert.equal(frame, 0);
  const seen = page.seen.length;
  page.player.handle({ type: "restarted", connection: 2, resumeAt: { action: "play", frame: 30, atUs: atUs + 300_000 } });
  await page.until("the end", () => page.player.shown?.frame === FRAMES - 1);
  const next = page.seen.slice(seen).find((at) => at > from)!;
  assert.ok(next < 30, `frames before that are shown when they are due, and not ${next}`);
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

test("who asks to play while a frame is sought sees that frame first", async () => {
  const page = new Page(false);
  page.whole(0);
  await page.until("a frame", () => (page.player.shown?.frame ?? 0) >= 5);
  page.player.pause();
  page.source.kept = NO_FRAMES;
  page.player.seek(30);
  await page.until("the jump", () => page.actions.at(-1) === "seek");
  page.player.play();
  assert.equal(page.actions.at(-1), "seek", "the source holds there");
  page.player.handle({ type: "flushed" });
  page.whole(30);
  assert.equal(page.actions.at(-1), "play");
  assert.equal(page.source.told.at(-1)!.frame, 30);
  await page.until("the play", () => page.player.shown!.frame > 30);
});

test("nothing is drawn before there is a device with its shaders, and the server refines the first frame meanwhile", async () => {
  let made = (): void => {};
  let prepared = (): void => {};
  const page = new Page(
    false,
    new Promise<void>((resolve) => (prepared = resolve)),
    new Promise<void>((resolve) => (made = resolve)),
  );
  page.whole(0);
  for (const step of [() => {}, made, () => {}]) {
    step();
    page.player.step();
    await sleep(5);
    assert.deepEqual([page.actions, page.source.asked.length], [["pause"], 0]);
  }
  prepared();
  await page.until("a picture", () => page.player.shown !== null);
  await page.until("the play", () => page.actions.length > 1);
  assert.deepEqual(page.actions, ["pause", "play"]);
});

test("the first frame is held, and seen, until a quarter of a second brings nothing more", async () => {
  const page = new Page(false);
  const begun = nowUs();
  page.whole(0);
  await page.until("a picture of what is held", () => page.player.shown !== null);
  let newest = 0;
  while (nowUs() - begun < 300_000) {
    page.player.handle({ type: "arrived", atUs: (newest = nowUs()), tile: true, equipped: true });
    page.player.step();
    await sleep(20);
  }
  assert.deepEqual(page.actions, ["pause"], "more comes still");
  assert.ok(page.source.asked.length > 1, "and is shown");
  assert.ok(page.source.asked.every(({ frame }) => frame === 0));
  await page.until("the play", () => page.actions.length > 1);
  const { action, frame, atUs } = page.source.told[1]!;
  assert.deepEqual([action, frame], ["play", 0]);
  assert.ok(atUs - 250_000 >= newest + 250_000 && atUs - 250_000 < begun + 2e6);
});

test("the first frame is held no longer than it may be, and not at all for a viewer who does not play", async () => {
  const page = new Page(false);
  const begun = nowUs();
  page.whole(0);
  await page.until("the play", () => {
    page.player.handle({ type: "arrived", atUs: nowUs(), tile: true, equipped: true });
    return page.actions.length > 1;
  });
  const heldUs = page.source.told[1]!.atUs - 250_000 - begun;
  assert.ok(heldUs >= 700_000 && heldUs < 2e6, `${heldUs} us`);

  const paused = new Page(false);
  paused.player.pause();
  paused.whole(0);
  await paused.until("its beginning", () => paused.actions.length > 1);
  assert.deepEqual(paused.actions, ["pause", "pause"]);
  assert.ok(!paused.player.waiting);
});

test("the reference that greets is seen while the first frame is held, and forgotten when it is played", async () => {
  const page = new Page(false);
  const greeting = { frame: 0, seq: 0, order: 1, connection: 1, kind: "nothing", basis: 4, data: new Uint8Array(0) };
  page.player.handle({ type: "reference", reference: greeting as unknown as Reference });
  page.whole(0);
  await page.until("a picture", () => page.player.shown !== null);
  assert.equal(page.source.asked.at(-1)!.basis, 4);
  const held = page.source.asked.length;
  await page.until("the play", () => page.source.asked.length > held && page.actions.includes("play"));
  await page.until("some of it", () => page.player.shown!.frame > 10);
  const played = page.source.asked.slice(page.source.asked.findIndex(({ basis }) => basis === undefined));
  assert.ok(played.every(({ basis }) => basis === undefined), "it is not added to any picture of the play");
  assert.ok(played[0]!.frame < 10, "nor to its first ones");
});

test("a still is drawn anew only where there is something new", async () => {
  const page = new Page(true, Promise.resolve(), Promise.resolve(), { loop: true });
  page.player.handle({ type: "info", info: { ...INFO, frames: 1, waits: true } as unknown as SceneInfo });
  page.whole(0);
  await page.until("a picture", () => page.player.pictures > 0);
  const { pictures } = page.player;
  const ends = nowUs() + 300_000;
  await page.until("a while", () => nowUs() > ends);
  assert.equal(page.player.pictures, pictures);
  page.whole(0);
  await page.until("another picture", () => page.player.pictures > pictures);
});

test("nothing is held of a scene that nobody refines", async () => {
  const page = new Page(true);
  page.whole(0);
  await page.until("the play", () => page.actions.length > 0);
  assert.deepEqual(page.actions, ["play"]);
});

test("a device that is too slow draws fewer pixels and then fewer frames, and pictures before the play do not count", async () => {
  const page = new Page(false);
  page.drawMs = 60;
  page.whole(0);
  const begun = nowUs();
  await page.until("the play", () => {
    if (nowUs() - begun < 700_000) page.player.handle({ type: "arrived", atUs: nowUs(), tile: true, equipped: true });
    return page.actions.includes("play");
  });
  assert.ok(page.source.asked.length >= 3, "several pictures were drawn");
  assert.deepEqual([page.player.scale, page.player.cadencePermille], [1, 1000]);
  page.player.setLoop(true);
  let fewer = 1000;
  await page.until("fewer pixels", () => {
    fewer = Math.min(fewer, page.player.scale < 1 ? 1000 : page.player.cadencePermille);
    return page.player.scale < 1;
  });
  assert.equal(fewer, 1000, "every frame is worth more than pixels");
  await page.until("fewer frames", () => page.player.cadencePermille < 1000);
  assert.equal(page.player.scale, 0.35);
});

test("patches that the device has go back to the source once, but for those of all rows", async () => {
  const page = new Page(true);
  const blocks: ArrayBuffer[] = [];
  const answered = page.source.frame.bind(page.source);
  page.source.frame = async (request) => {
    const words = new Uint32Array(4);
    blocks.push(words.buffer);
    return { ...(await answered(request)), fresh: blocks.length === 1, patches: [{ words }] } as unknown as FrameUpdate;
  };
  page.whole(...upTo(30));
  await page.until("ten pictures", () => page.source.asked.length > 10);
  const back = page.source.asked.flatMap(({ spent }) => spent ?? []);
  assert.deepEqual(back, blocks.slice(1, 1 + back.length));
  assert.ok(back.length >= page.source.asked.length - 3, "every one but the newest");
});

const SOON = [Promise.resolve(), Promise.resolve()] as const;

test("a play begins at the moment that is asked for, by the scene's own frame rate, and beyond the end at the last frame", async () => {
  for (const [startSeconds, first] of [[0.3, 30], [100, FRAMES - 1], [1e300, FRAMES - 1]] as const) {
    const page = new Page(true, ...SOON, { startSeconds, playing: false });
    assert.equal(page.player.frame, first);
    page.whole(first);
    await page.until("its picture", () => page.player.shown?.frame === first);
    assert.ok(!page.player.waiting);
    assert.deepEqual(page.source.told.map(({ action, frame }) => [action, frame]), [["pause", first]]);
  }
});

test("who seeks before the play has begun gets there, without waiting for the detail of the first frame", async () => {
  const page = new Page(false);
  page.player.seek(40);
  assert.equal(page.player.seconds, 0.4, "the slider stays where it was put");
  page.whole(0);
  const begun = nowUs();
  await page.until("the jump", () => page.actions.includes("seek"));
  assert.ok(nowUs() - begun < 200_000);
  assert.equal(page.source.told.find(({ action }) => action === "seek")!.frame, 40);
  page.whole(40);
  await page.until("its picture", () => page.player.shown?.frame === 40);
});

test("a play begins at the speed that its options say", async () => {
  const page = new Page(true, ...SOON, { rate: 0.25 });
  page.whole(...upTo(20));
  await page.until("the play", () => page.actions.includes("play"));
  assert.deepEqual([page.player.rate, page.source.told.at(-1)!.rate], [0.25, 0.25]);
});

test("a play that has ended, whoever ended it, leaves the source", async () => {
  const told = new Page(true);
  told.player.handle({ type: "error", error: { code: "scene", message: "damaged", fatal: true } });
  const drawn = new Page(true);
  drawn.broken = true;
  drawn.whole(...upTo(20));
  await drawn.until("the error", () => drawn.errors.length > 0);
  for (const { errors, player, source } of [told, drawn]) {
    assert.equal(errors.length, 1);
    void player.close();
    assert.equal(source.closed, 1, "once");
  }
});

test("a play that is left says when it draws no more, and uploads nothing afterwards", async () => {
  const page = new Page(true);
  page.drawMs = 50;
  page.whole(...upTo(20));
  await page.until("a picture under way", () => page.uploads > 0 && page.player.drawing);
  const { pictures } = page.player;
  const left = page.player.close();
  assert.ok(page.player.drawing);
  await left;
  assert.deepEqual([page.player.drawing, page.player.pictures], [false, pictures]);

  const late = new Page(true);
  let answer = (): void => {};
  const answered = late.source.frame.bind(late.source);
  late.source.frame = async (request) => {
    await new Promise<void>((resolve) => (answer = resolve));
    return answered(request);
  };
  late.whole(...upTo(20));
  await late.until("a question", () => late.player.drawing);
  const gone = late.player.close();
  answer();
  await gone;
  assert.equal(late.uploads, 0);
  assert.deepEqual(late.errors, []);
});
