/** What anybody may write into an address, send to the page, or do to its window; and what the page says of its picture. */

import assert from "node:assert/strict";
import { registerHooks } from "node:module";
import test from "node:test";
import { headingsOf } from "../../src/page/author.ts";
import { acts, goneTo } from "../../src/page/bar.ts";
import { lasts } from "../../src/page/facts.ts";
import { drawnFigures } from "../../src/page/inspector.ts";
import { verdictOf } from "../../src/page/light.ts";
import { bearer, givenPose, hashOf, leave, movedTo, type Place, placeOf, taken } from "../../src/page/place.ts";
import { anglesOf, intrinsicsOf, MOST_PIXELS, pixelsOf, usableSize } from "../../src/page/view.ts";
import type { Gpu } from "../../src/gpu/device.ts";
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

test("a token is known on through new addresses, until one says another", () => {
  assert.deepEqual(movedTo("#t=2", { token: "old", seconds: 1, loop: false }), { token: "old", seconds: 2 });
  assert.deepEqual(movedTo("#token=new", { token: "old" }), { token: "new" });
  assert.deepEqual(movedTo("#t=2", {}), { seconds: 2 });
});

/** As much of a tab's storage as is used. */
class Drawer extends Map<string, string> {
  getItem(key: string): string | null {
    return this.get(key) ?? null;
  }
  setItem(key: string, value: string): void {
    this.set(key, value);
  }
  removeItem(key: string): void {
    this.delete(key);
  }
}

test("a page that is loaded anew goes on with all that it knew, once, and no link says the token", () => {
  const storage = new Drawer() as unknown as Storage;
  const place: Place = {
    seconds: 1.25, pose: { position: [1, 2, 3], rotation: [0.6, 0, 0.8, 0] }, mode: "fly", playing: false, loop: false, token: "sesame",
    target: [0, 0, 9], background: "#1a2b3c", size: [640, 480],
  };
  leave(storage, "http://here/?scene=a#t=1", { place, why: "It was lost" });
  assert.deepEqual(taken(storage, "http://here/?scene=a#t=1"), { place, why: "It was lost" });
  assert.equal(taken(storage, "http://here/?scene=a#t=1"), undefined, "a later visit begins where the address says");
  leave(storage, "http://here/?scene=a", { place, why: "It was lost" });
  assert.equal(taken(storage, "http://here/?scene=b"), undefined);
  assert.doesNotMatch(hashOf(1.25, place.pose!, "fly"), /sesame|token/);
});

/** Shaders and their graph are files that the page's build bundles, and node does not: here nothing is compiled. */
const EMPTY = { format: "module", source: "export default { passes: {}, buffers: {} }", shortCircuit: true } as const;
registerHooks({ load: (url, context, next) => (/\.(json|wgsl)$/.test(url) ? EMPTY : next(url, context)) });

/** A graphics device that goes wrong when a test says so. */
async function device(): Promise<{ device: EventTarget; told: string[]; gpu: Gpu; refuse(error: Error): void }> {
  class GPUOutOfMemoryError extends Error {}
  const made = Object.assign(new EventTarget(), { limits: { maxStorageBufferBindingSize: 1, maxBufferSize: 1 }, lost: new Promise(() => undefined), destroy: () => undefined });
  const adapter = { limits: {}, info: {}, requestDevice: () => Promise.resolve(made) };
  Object.assign(globalThis, { isSecureContext: true, GPUOutOfMemoryError });
  Object.defineProperty(globalThis, "navigator", { configurable: true, value: { gpu: { requestAdapter: () => Promise.resolve(adapter) } } });
  const told: string[] = [];
  const { Gpu } = await import("../../src/gpu/device.ts");
  const gpu = await Gpu.make({ lost: () => told.push("lost"), refused: (message) => told.push(message) });
  return { device: made, told, gpu, refuse: (error) => made.dispatchEvent(Object.assign(new Event("uncapturederror"), { error })) };
}

test("a device that refuses what it is given is told of, once, in a sentence", async () => {
  const full = await device();
  full.refuse(new (globalThis as unknown as { GPUOutOfMemoryError: new () => Error }).GPUOutOfMemoryError());
  full.refuse(new Error("[Invalid Buffer] is invalid"));
  assert.deepEqual(full.told, ["The graphics processor has no memory left for this scene; close other pages and programs that draw, and try again."]);
  const odd = await device();
  odd.refuse(new Error("[Buffer] is too large\n - While calling"));
  assert.deepEqual(odd.told, ["The graphics processor refused a step of the drawing ([Buffer] is too large)"]);
  const gone = await device();
  gone.gpu.destroy();
  gone.refuse(new Error("late"));
  assert.deepEqual(gone.told, []);
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

test("a step is from where the play goes to, even while another frame is shown", () => {
  const info = { name: "clip", frames: 90, fps: 30 };
  assert.equal(goneTo({ info, seconds: 14 / 30, frame: 11 }), 14);
  for (let frame = 0; frame < info.frames; frame++) assert.equal(goneTo({ info, seconds: frame / 30, frame }), frame);
});

test("scenes of one title can be told apart", () => {
  const scenes = [["a", "procedural"], ["b", "procedural"], ["vase", "Vase"], ["procedural", "procedural"]].map(([name, title]) => ({ name: name!, title: title! }));
  assert.deepEqual(headingsOf(scenes), ["procedural (a)", "procedural (b)", "Vase", "procedural"]);
});

test("a clip's length is said without sixty seconds", () => {
  assert.deepEqual([0, 9.94, 9.97, 59.4, 59.7, 119.7, 120, 61].map(lasts), ["0.0 s", "9.9 s", "10 s", "59 s", "1 min 0 s", "2 min 0 s", "2 min 0 s", "1 min 1 s"]);
});

test("a still, whole picture is not said to lack frames, and no figure is of corrections where none come", () => {
  const player = {
    info: { lods: 3, fps: 30 }, status: { link: "open", references: false, bytesTiles: 1, bytesReference: 0, bytesOther: 0 }, waiting: false, playing: false,
    cadencePermille: 500, scale: 1, missed: 0, shown: null,
  };
  const update = { missed: false, lodMean: 2 };
  const still = { ...player, shown: { update, atUs: nowUs() } } as unknown as Player;
  assert.deepEqual(verdictOf(still), { state: "good", text: "good" });
  assert.deepEqual(verdictOf({ ...still, playing: true } as Player), { state: "fair", text: "this device: fewer frames" });
  const names = (references: boolean): string[] => drawnFigures(player as unknown as Player, "", 0, references).map(([name]) => name);
  assert.deepEqual(names(true).filter((name) => !names(false).includes(name)), ["Corrections", "Correction age"]);
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

test("a token of any script is shown to the server as UTF-8", () => {
  const sent = bearer("schlüssel 鍵");
  assert.equal(new TextDecoder().decode(Uint8Array.from(sent, (each) => each.charCodeAt(0))), "Bearer schlüssel 鍵");
  assert.doesNotThrow(() => new Headers({ Authorization: sent }));
});
