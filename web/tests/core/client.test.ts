/** A page whose pictures a client draws: what it says is what the client reads, and whose the camera is. */

import assert from "node:assert/strict";
import test from "node:test";
import * as to from "../../src/client/messages.ts";
import type { FrameHead, SceneText, StateText } from "../../src/client/messages.ts";
import { capOf, stepOf } from "../../src/client/panel.ts";
import { Line } from "../../src/client/line.ts";
import { ClientPlayer } from "../../src/client/player.ts";
import type { Pose } from "../../src/seam.ts";
import { fromHex, hex, vectors } from "./vectors.ts";

interface Said {
  readonly page: readonly { readonly name: string; readonly fields: unknown }[];
  readonly client: { readonly scene: SceneText; readonly state: StateText };
  readonly frame: { readonly head: FrameHead; readonly payloads: readonly string[]; readonly data: string };
}
const { page, client, frame } = vectors<Said>("messages");
const AT_US = 1_700_000_000_123_456;
Object.assign(globalThis, { document: { hidden: false } });

test("the page says what the client reads", () => {
  const said: Record<string, string> = {
    hello: to.hello({ h264: true, raw: false }),
    "hello with a token": to.hello({ h264: true, raw: true }, "sesame"),
    pose: to.moved(AT_US, { position: [1, 2, 3], rotation: [0.6, 0, -0.8, 0] }),
    window: to.windowed(1280, 720),
    look: to.look({ pictures: ["restored", "truth"], overlays: ["tiles", "score"] }),
    pause: to.set("playing", false),
    seek: to.set("frame", 12),
    speed: to.set("rate", 0.5),
    loop: to.set("loop", true),
    release: to.set("held", false),
    choice: to.set("restorer", "none"),
    cap: to.set("cap_mbps", 4.5),
    "no cap": to.set("cap_mbps", null),
    delay: to.set("delay_ms", 60),
    drawn: to.drawn(9, false),
    lost: to.drawn(10, true),
  };
  assert.deepEqual(Object.keys(said), page.map(({ name }) => name));
  for (const { name, fields } of page) assert.deepEqual(JSON.parse(said[name]!), fields, name);
});

test("a frame is taken apart as the client put it together", () => {
  const { head, pictures, grids } = to.unpack(fromHex(frame.data).buffer);
  assert.deepEqual(head, frame.head);
  assert.deepEqual([...pictures, ...grids].map(hex), frame.payloads);
});

test("the cap's slider is logarithmic, and its end lifts the cap", () => {
  assert.equal(capOf(100), null);
  assert.deepEqual([stepOf(null), stepOf(0.5), stepOf(150), stepOf(1e6), stepOf(0)], [100, 0, 99, 99, 0]);
  for (const step of [0, 17, 50, 99]) assert.equal(stepOf(capOf(step)), step);
});

/** A socket that does what a test says. */
class Wire extends EventTarget {
  static readonly OPEN = 1;
  static readonly all: Wire[] = [];
  readyState = 1;
  constructor() {
    super();
    Wire.all.push(this);
  }
  send(): void {}
  close(): void {}
  now(type: string, fields: object = {}): void {
    this.dispatchEvent(Object.assign(new Event(type), fields));
  }
}

test("a line that was refused says why and does not ask again; one that only opens is asked ever more slowly", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  Object.assign(globalThis, { WebSocket: Wire, window: globalThis });
  const told: string[] = [];
  const line = (): Line =>
    new Line("ws://here/live", {
      opened: () => undefined, text: () => undefined, frame: () => undefined, closed: () => told.push("closed"),
      refused: (why, reason) => told.push(`${why}: ${reason}`),
    });
  for (const [code, why] of [[4401, "token"], [4429, "room"], [1013, "room"], [1008, "message"]] as const) {
    line();
    const { length } = Wire.all;
    Wire.all.at(-1)!.now("open");
    Wire.all.at(-1)!.now("close", { code, reason: "words" });
    t.mock.timers.tick(60_000);
    assert.deepEqual([told.pop(), told.length, Wire.all.length], [`${why}: words`, 0, length]);
  }
  const asked = (ms: number): number => {
    const { length } = Wire.all;
    Wire.all.at(-1)!.now("open");
    Wire.all.at(-1)!.now("close", { code: 1006, reason: "" });
    t.mock.timers.tick(ms);
    return Wire.all.length - length;
  };
  line();
  assert.deepEqual([asked(300), asked(300)], [1, 0]);
  t.mock.timers.tick(700);
  assert.deepEqual([asked(1999), Wire.all.at(-1)!.readyState], [0, 1]);
  t.mock.timers.tick(1);
  Wire.all.at(-1)!.now("message", { data: "{}" });
  assert.equal(asked(300), 1, "one that spoke is asked at once again");
});

/** A page without a screen. */
class Watcher {
  camera: Pose = { position: [0, 0, 0], rotation: [1, 0, 0, 0] };
  readonly said: Record<string, unknown>[] = [];
  readonly player = new ClientPlayer({
    send: (text) => this.said.push(JSON.parse(text) as Record<string, unknown>),
    show: () => undefined,
    pose: () => this.camera,
    follow: ({ position, rotation }) => (this.camera = { position, rotation }),
    leave: () => this.said.push({ type: "left" }),
  });

  constructor(steers: boolean) {
    this.player.meet(client.scene);
    this.player.told({ ...client.state, steers });
  }

  /** Take a frame from a place, and refresh the screen. */
  shown(x: number, more: Partial<FrameHead> = {}): void {
    const camera = { ...frame.head.camera, position: [x, 0, 0] as const };
    this.player.came({ head: { ...frame.head, pose_at_us: null, camera, ...more }, grids: [], images: new Map() });
    this.player.step();
  }

  goTo(x: number): void {
    this.camera = { position: [x, 0, 0], rotation: [1, 0, 0, 0] };
    this.player.step();
  }

  of(type: string): Record<string, unknown>[] {
    return this.said.filter((message) => message["type"] === type);
  }
}

test("the camera follows the picture until a hand moves it; then poses go out with their times, one for each place", () => {
  const watcher = new Watcher(true);
  watcher.shown(1);
  watcher.shown(2);
  assert.deepEqual([watcher.camera.position[0], watcher.of("pose").length], [2, 0]);
  watcher.goTo(5);
  watcher.player.step();
  watcher.shown(2);
  assert.equal(watcher.camera.position[0], 5, "a picture of where it was does not bring it back");
  watcher.goTo(6);
  const poses = watcher.of("pose");
  assert.deepEqual(poses.map(({ position }) => position), [[5, 0, 0], [6, 0, 0]]);
  const [first, second] = poses.map((pose) => pose["at_us"] as number);
  assert.ok(Number.isInteger(first) && first! <= second!);
  watcher.shown(6, { pose_at_us: second! });
  watcher.shown(6, { pose_at_us: second! });
  assert.equal(watcher.player.photonMs.length, 1, "measured by the first picture that shows it");
  watcher.player.release();
  watcher.shown(3);
  assert.equal(watcher.camera.position[0], 3);
});

test("a page that watches sends no pose, and follows again after its hand has tried", () => {
  const watcher = new Watcher(false);
  watcher.shown(1);
  watcher.goTo(9);
  assert.equal(watcher.of("pose").length, 0);
  watcher.shown(2);
  assert.equal(watcher.camera.position[0], 2);
  watcher.player.told({ ...client.state, steers: true });
  watcher.goTo(9);
  assert.equal(watcher.of("pose").length, 1, "once it steers, it does");
});

test("every picture is acknowledged once, but for those of a page that nobody sees", () => {
  const watcher = new Watcher(true);
  const come = (number: number): void => watcher.player.came({ head: { ...frame.head, number }, grids: [], images: new Map() });
  come(1);
  come(2);
  watcher.player.step();
  assert.deepEqual(watcher.of("shown").map(({ number }) => number), [1, 2]);
  Object.assign(document, { hidden: true });
  come(3);
  come(4);
  assert.equal(watcher.of("shown").length, 2);
  Object.assign(document, { hidden: false });
  watcher.player.step();
  assert.deepEqual(watcher.of("shown").map(({ number }) => number), [1, 2, 4]);
});

test("a jump is where the play is until its picture has come", () => {
  const watcher = new Watcher(true);
  watcher.shown(0);
  watcher.player.seek(1e9);
  const last = client.scene.frames - 1;
  assert.deepEqual(watcher.of("set"), [{ type: "set", name: "frame", value: last }]);
  assert.deepEqual([watcher.player.frame, watcher.player.waiting], [last, true]);
  watcher.shown(0);
  assert.equal(watcher.player.frame, last);
  watcher.shown(0, { frame: last });
  assert.equal(watcher.player.waiting, false);
});
