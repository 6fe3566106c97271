import assert from "node:assert/strict";
import { after, test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { crc32 } from "../../src/bytes/crc32.ts";
import { type ConnectOptions, type SourceEvent, within } from "../../src/seam.ts";
import type { FrameEntry } from "../../src/source/bundleIndex.ts";
import { baseWishes, ranges } from "../../src/source/plan.ts";
import { type Fetch, StaticSource } from "../../src/source/static.ts";
import { draco, kernels, vectors } from "./vectors.ts";

const url = process.env["CAGS_FOLDER"]!;
const expected = vectors<{ ids: number[]; columns: Record<string, number> }[]>("expected");
const decoders = Promise.all([kernels(), draco()]).then(([wasm, decoder]) => ({ kernels: wasm, draco: decoder }));
const OPTIONS: ConnectOptions = {
  intrinsics: { widthPx: 400, heightPx: 300, fxPx: 60, fyPx: 60, cxPx: 200, cyPx: 150 },
  pose: { position: [0, 0, 0], rotation: [1, 0, 0, 0] },
};

type Events = SourceEvent[];

const sources: StaticSource[] = [];
after(() => sources.forEach((source) => source.close()));

type Loaded = Awaited<typeof decoders>;

/** Decoders that come when they are told to. */
function onTheirWay(): { promise: Promise<Loaded>; resolve: (loaded: Loaded) => void; reject: (error: Error) => void } {
  let [resolve, reject]: [(loaded: Loaded) => void, (error: Error) => void] = [() => {}, () => {}];
  const promise = new Promise<Loaded>((done, failed) => ([resolve, reject] = [done, failed]));
  return { promise, resolve, reject };
}

function opened(fetchAt?: Fetch): StaticSource {
  const source = new StaticSource(decoders, fetchAt);
  sources.push(source);
  return source;
}

/** From here on past groups are dropped, as in a clip that is too large to be kept whole. */
function pass(source: StaticSource): void {
  (source as unknown as { scene: { store: { whole: boolean } } }).scene.store.whole = false;
}

async function until(what: string, found: () => unknown): Promise<void> {
  for (let tries = 0; tries < 1000 && !found(); tries++) await sleep(10);
  assert.ok(found(), `${what} did not come`);
}

function whole(events: Events, frame: number): boolean {
  return events.some((event) => event.type === "whole" && event.frame === frame);
}

/** Show `frame` until everything of it is there; what is shown then. */
async function complete(source: StaticSource, frame: number): Promise<{ ids: number[]; columns: Record<string, number> }> {
  for (let tries = 0; ; tries++) {
    const { full, missed } = await source.frame({ frame });
    if (full && !missed) break;
    assert.ok(tries < 1000, `all of frame ${frame} did not come`);
    await sleep(10);
  }
  const { buffer } = (source as unknown as { scene: { store: { onDisplay: { buffer: import("../../src/store/splatBuffer.ts").SplatBuffer } } } }).scene.store.onDisplay;
  const logits = buffer.column("logit_opacities");
  const ids = [...logits.keys()].filter((id) => logits[id]! > -30);
  const names = ["means", "quats", "log_scales", "logit_opacities", "sh0", "sh_rest"] as const;
  const columns = names.map((name) => {
    const [column, width] = [buffer.column(name), buffer.width(name)];
    const rows = Float32Array.from(ids.flatMap((id) => [...column.subarray(id * width, (id + 1) * width)]));
    return [name, crc32(new Uint8Array(rows.buffer))] as const;
  });
  return { ids, columns: Object.fromEntries(columns) };
}

test("all that the first frame needs is fetched while the decoders are on their way, and nothing beside it", { timeout: 60_000 }, async () => {
  const [events, asked]: [Events, string[]] = [[], []];
  let [underWay, untilWhole] = [0, 0];
  const late = onTheirWay();
  const source = new StaticSource(late.promise, async (at, init) => {
    asked.push(`${at.slice(url.length)} ${new Headers(init?.headers).get("range") ?? "all"}`);
    underWay += 1;
    return fetch(at, init).finally(() => (underWay -= 1));
  });
  sources.push(source);
  source.connect(url, OPTIONS, (event) => {
    events.push(event);
    if (event.type === "whole" && event.frame === 0) untilWhole = asked.length;
  });
  await until("manifest, codebooks, index and the first frame's base", () => asked.length === 4 && !underWay);
  assert.match(asked[0]!, /manifest.* all$/);
  assert.match(asked[1]!, /codebooks.* all$/);
  assert.match(asked[2]!, /gof.* bytes=/);
  assert.match(asked[3]!, /gof.* bytes=8-/, "where a group's tiles begin");
  await sleep(100);
  assert.ok(!events.some((event) => event.type === "info"));
  assert.equal(asked.length, 4);
  late.resolve(await decoders);
  await until("frame 0", () => whole(events, 0));
  assert.equal(untilWhole, 4, "other frames are asked for once the first is there");
  await until("frame 1", () => whole(events, 1));
});

test("after a jump, too, the frame that it goes to is fetched first and alone", { timeout: 60_000 }, async () => {
  const [events, asked]: [Events, string[]] = [[], []];
  let [before, wanted]: [number, string[]] = [0, []];
  const source = opened((at, init) => {
    asked.push(new Headers(init?.headers).get("range") ?? "all");
    return fetch(at, init);
  });
  source.connect(url, OPTIONS, (event) => {
    events.push(event);
    if (event.type === "whole" && event.frame === 3 && events.some(({ type }) => type === "flushed")) wanted = asked.slice(before);
  });
  await until("the last frame", () => whole(events, expected.length - 1));
  source.control({ action: "pause", frame: 0, atUs: 0 });
  for (let frame = 0; frame < expected.length; frame++) await complete(source, frame);
  pass(source);
  await complete(source, expected.length - 1);
  assert.ok(!within(source.kept, 3));
  before = asked.length;
  source.control({ action: "seek", frame: 3, atUs: 0 });
  await until("frame 3", () => wanted.length);
  const { groups } = source as unknown as { groups: Map<number, { frames: FrameEntry[] }> };
  const needed = [...groups.values()][0]!.frames.filter(({ frame }) => frame <= 3);
  const ends = ranges(needed.flatMap(baseWishes), needed).map(({ start, end }) => `bytes=${start}-${end - 1}`);
  assert.deepEqual(wanted.slice(1).sort(), ends.sort(), "index, then what frame 3 needs");
});

test("a viewer that leaves before its decoders have come takes nothing with it", { timeout: 60_000 }, async () => {
  const events: Events = [];
  const late = onTheirWay();
  const source = new StaticSource(late.promise);
  source.connect(url, OPTIONS, (event) => events.push(event));
  source.close();
  late.resolve(await decoders);
  await sleep(200);
  assert.ok(!events.some((event) => event.type === "info" || event.type === "error"));
});

test("decoders that do not come are said once", { timeout: 60_000 }, async () => {
  const events: Events = [];
  const late = onTheirWay();
  const source = new StaticSource(late.promise);
  sources.push(source);
  source.connect(url, OPTIONS, (event) => events.push(event));
  late.reject(new Error("the viewer's decoders cannot be fetched from the server"));
  await until("the error", () => events.some((event) => event.type === "error"));
  await sleep(200);
  const errors = events.filter((event) => event.type === "error").map(({ error }) => [error.message, error.fatal]);
  assert.deepEqual(errors, [["the viewer's decoders cannot be fetched from the server", true]]);
});

test("a folder plays to its end, seeks, and shows the bundle in full", { timeout: 60_000 }, async () => {
  const events: Events = [];
  const asked: string[] = [];
  const counting: Fetch = (at, init) => {
    asked.push(`${at} ${new Headers(init?.headers).get("range") ?? ""}`);
    return fetch(at, init);
  };
  const source = opened(counting);
  source.connect(url, OPTIONS, (event) => events.push(event));
  await until("frame 0", () => whole(events, 0));
  assert.equal(events.findIndex((event) => event.type === "info") < events.findIndex((event) => event.type === "whole"), true);
  source.control({ action: "pause", frame: 0, atUs: 0 });
  for (let frame = 0; frame < expected.length; frame++) {
    await until(`frame ${frame}`, () => whole(events, frame));
    assert.deepEqual(await complete(source, frame), expected[frame], `frame ${frame}`);
    await source.frame({ frame, share: 0.5 });
  }
  const ends = events.filter((event) => event.type === "whole").map((event) => event.frame);
  assert.deepEqual(ends, [...ends].sort((a, b) => a - b));
  const [flushed, requests] = [events.filter((event) => event.type === "flushed").length, asked.length];
  assert.deepEqual(source.kept, [0, expected.length]);
  for (const frame of [3, expected.length - 1, 1]) {
    source.control({ action: "seek", frame, atUs: 0 });
    assert.deepEqual(await complete(source, frame), expected[frame]);
  }
  assert.equal(events.filter((event) => event.type === "flushed").length, flushed);
  assert.equal(asked.length, requests, "nothing is fetched twice");
  pass(source);
  await complete(source, expected.length - 1);
  assert.ok(!within(source.kept, 0));
  source.control({ action: "seek", frame: 3, atUs: 0 });
  assert.ok(events.some((event) => event.type === "flushed"));
  assert.deepEqual(await complete(source, 3), expected[3]);
  assert.equal(asked.filter((request) => request.includes("manifest.json")).length, 1);
  assert.ok(asked.length < 120, `${asked.length} requests`);
});

test("a host that is away for a while is asked again; one without the scene is told of", { timeout: 30_000 }, async () => {
  const events: Events = [];
  let failures = 3;
  const source = opened((at, init) => (failures-- > 0 ? Promise.reject(new TypeError("away")) : fetch(at, init)));
  source.connect(url, OPTIONS, (event) => events.push(event));
  await until("frame 0", () => whole(events, 0));
  assert.deepEqual(events.filter((event) => event.type === "error").map((event) => event.error.fatal), [false]);

  const missing: Events = [];
  opened().connect(`${url}nothing/`, OPTIONS, (event) => missing.push(event));
  await until("an error", () => missing.some((event) => event.type === "error" && event.error.fatal));
});

/** A host whose answers that are part of a file come damaged while `damages`; and with which cache mode each was asked. */
function damaging(damages: (range: string, asked: number) => boolean): { fetchAt: Fetch; asked: string[] } {
  const asked: string[] = [];
  const fetchAt: Fetch = async (at, init) => {
    const range = new Headers(init?.headers).get("range") ?? "";
    asked.push(`${init?.cache ?? "default"} ${range || at.slice(url.length)}`);
    const answer = await fetch(at, init);
    if (!range || !damages(range, asked.length)) return answer;
    const body = new Uint8Array(await answer.arrayBuffer());
    return new Response(body.map((byte) => byte ^ 1), { status: answer.status });
  };
  return { fetchAt, asked };
}

test("what comes damaged is fetched once more, past the caches", { timeout: 60_000 }, async () => {
  const events: Events = [];
  const seen = new Set<string>();
  const { fetchAt, asked } = damaging((range) => !seen.has(range) && Boolean(seen.add(range)));
  const source = opened(fetchAt);
  source.connect(url, OPTIONS, (event) => events.push(event));
  await until("frame 0", () => whole(events, 0));
  source.control({ action: "pause", frame: 0, atUs: 0 });
  assert.deepEqual(await complete(source, 0), expected[0]);
  const again = asked.filter((request) => request.startsWith("reload "));
  assert.ok(again.length > 2 && new Set(again).size === again.length, "once each");
  assert.ok(again.every((request) => seen.has(request.slice("reload ".length))));
  assert.ok(!events.some((event) => event.type === "error"));
});

test("what stays damaged ends the play, and the file is named", { timeout: 60_000 }, async () => {
  for (const [first, what] of [[0, "the index"], [1, "a tile"]] as const) {
    const events: Events = [];
    const ranges = new Set<string>();
    opened(damaging((range) => ranges.add(range).size > first).fetchAt).connect(url, OPTIONS, (event) => events.push(event));
    await until(`the error of ${what}`, () => events.some((event) => event.type === "error"));
    const errors = events.flatMap((event) => (event.type === "error" ? [event.error] : []));
    assert.equal(errors[0]!.fatal, true);
    assert.match(errors[0]!.message, /^gof-[\w-]+\.bin was damaged or replaced; reload the page$/);
    assert.ok(!whole(events, 0), "no frame is told whole without its tiles");
  }
});

test("the manifest is asked for anew, so that a folder that was published again is seen", { timeout: 60_000 }, async () => {
  const { fetchAt, asked } = damaging(() => false);
  const events: Events = [];
  opened(fetchAt).connect(url, OPTIONS, (event) => events.push(event));
  await until("frame 0", () => whole(events, 0));
  const cached = asked.filter((request) => !request.includes("manifest.json"));
  assert.deepEqual([asked.length - cached.length, asked.includes("no-cache manifest.json")], [1, true]);
  assert.ok(cached.every((request) => request.startsWith("default ")));
});

test("a play begins at a moment of the clip, and beyond its end at the last frame", { timeout: 60_000 }, async () => {
  const events: Events = [];
  opened().connect(url, { ...OPTIONS, startSeconds: 1e9 }, (event) => events.push(event));
  await until("the last frame", () => whole(events, expected.length - 1));
  assert.ok(!events.some((event) => event.type === "error"));
});
