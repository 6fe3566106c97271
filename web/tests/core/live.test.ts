import assert from "node:assert/strict";
import { after, test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { isDeepStrictEqual } from "node:util";
import { crc32 } from "../../src/bytes/crc32.ts";
import { type ConnectOptions, type FrameUpdate, type Intrinsics, nowUs, type SourceEvent, within } from "../../src/seam.ts";
import { LiveSource } from "../../src/source/live.ts";
import { draco, kernels, vectors } from "./vectors.ts";

const url = process.env["CAGS_SERVER"]!;
const token = process.env["CAGS_TOKEN"]!;
/** Whether the clip, of two groups of frames, is kept whole; the server was told, too. */
const WHOLE = process.env["CAGS_WHOLE"] !== "0";
const decoders = { kernels: await kernels(), draco: await draco() };
const expected = vectors<{ ids: number[]; columns: Record<string, number> }[]>("expected");

const OPTIONS: ConnectOptions = {
  intrinsics: { widthPx: 400, heightPx: 300, fxPx: 60, fyPx: 60, cxPx: 200, cyPx: 150 },
  pose: { position: [0, 0, 0], rotation: [1, 0, 0, 0] },
  token,
};

/** A page without a display: keeps what patches say, as the GPU would. */
class Page {
  readonly events: SourceEvent[] = [];
  readonly source = new LiveSource(decoders, (to, protocol) => {
    const socket = new WebSocket(to, protocol);
    const send = socket.send.bind(socket);
    socket.send = (data) => {
      send(data);
      if (this.sockets.length > 2) this.onSent();
    };
    this.sockets.push(socket);
    return socket as never;
  });
  readonly sockets: WebSocket[] = [];
  onSent = (): void => {};
  private rows = new Map<number, Uint32Array>();
  private sh = 0;

  constructor(options: ConnectOptions = OPTIONS) {
    this.source.connect(url, options, (event) => {
      this.events.push(event);
      const { scene } = this.source as unknown as { scene: { manifest: { keptWhole: boolean }; store: { whole: boolean } } };
      if (event.type === "info" && !WHOLE) scene.manifest.keptWhole = scene.store.whole = false;
    });
  }

  /** Wait until `found` finds something among the events from the `from`-th on. */
  async until<T>(what: string, found: (event: SourceEvent) => T | undefined | false, from = 0): Promise<T> {
    for (let tries = 0; tries < 1500; tries++) {
      for (const event of this.events.slice(from)) {
        const one = found(event);
        if (one) return one;
      }
      this.source.sendPoses([{ tUs: nowUs(), pose: OPTIONS.pose }]);
      await sleep(10);
    }
    const seen = this.events.filter((event) => event.type !== "status").slice(-20);
    return assert.fail(`${what} did not come; ${JSON.stringify(seen, (_, v) => (typeof v === "bigint" ? `${v}` : v)).slice(0, 3000)}`);
  }

  async show(frame: number, share = 0): Promise<FrameUpdate> {
    const update = await this.source.frame({ frame, share });
    if (update.fresh) this.rows = new Map();
    this.sh = update.shCount;
    for (const { rows, width, words, looks } of update.patches) {
      for (let i = 0; i < rows; i++) {
        const row = words.slice(i * (1 + width), (i + 1) * (1 + width));
        const before = this.rows.get(row[0]!);
        const after = before?.slice() ?? new Uint32Array(14 + 3 * this.sh);
        after.set(row.subarray(1), 0);
        assert.equal(width, looks ? 14 + 3 * this.sh : 8);
        this.rows.set(row[0]!, after);
      }
    }
    return update;
  }

  told<T extends SourceEvent["type"]>(type: T): Extract<SourceEvent, { type: T }>[] {
    return this.events.filter((event): event is Extract<SourceEvent, { type: T }> => event.type === type);
  }

  /** Splats that are there, and the CRC-32 of each of their columns. */
  shown(): { ids: number[]; columns: Record<string, number> } {
    const absent = new Uint32Array(Float32Array.of(-30).buffer)[0];
    const ids = [...this.rows.keys()].filter((id) => this.rows.get(id)![3] !== absent).sort((a, b) => a - b);
    const place = { means: [0, 3], quats: [4, 8], log_scales: [8, 11], logit_opacities: [3, 4], sh0: [11, 14], sh_rest: [14, 14 + 3 * this.sh] };
    const columns = Object.entries(place).map(([name, [from, to]]) => {
      const words = Uint32Array.from(ids.flatMap((id) => [...this.rows.get(id)!.slice(from, to)]));
      return [name, crc32(new Uint8Array(words.buffer))] as const;
    });
    return { ids, columns: Object.fromEntries(columns) };
  }

  /**
   * Show `frame` until it is whole, at the highest level of everything, and as the bundle has it.
   *
   * A chunk that a busy server left out of the play comes while the clip stands still. Until then all that has come may
   * be at its highest level without being all there is.
   */
  async complete(frame: number): Promise<void> {
    for (let tries = 0; tries < 500; tries++) {
      const { missed, full } = await this.show(frame);
      if (!missed && full && isDeepStrictEqual(this.shown(), expected[frame])) break;
      this.source.sendPoses([{ tUs: nowUs(), pose: OPTIONS.pose }]);
      await sleep(20);
    }
    assert.deepEqual(this.shown(), expected[frame], `frame ${frame}`);
  }
}

const pages: Page[] = [];
after(() => pages.forEach((page) => page.source.close()));

function opened(options?: ConnectOptions): Page {
  const page = new Page(options);
  pages.push(page);
  return page;
}

test("a stream is the bundle, through seeks and a lost connection", { timeout: 100_000 }, async () => {
  const page = opened();
  const info = await page.until("info", (event) => event.type === "info" && event.info);
  assert.equal(info.frames, expected.length);
  assert.ok(info.moves);
  await page.until("frame 0", (event) => event.type === "whole" && event.frame === 0);
  page.source.control({ action: "pause", frame: 0, atUs: nowUs() });
  await page.complete(0);

  page.source.control({ action: "play", frame: 0, atUs: nowUs() + 200_000 });
  for (let frame = 0; frame < 6; frame++) {
    await page.until(`frame ${frame}`, (event) => event.type === "whole" && event.frame === frame);
    await page.show(frame);
    await page.show(frame, 0.5);
  }
  page.source.control({ action: "pause", frame: 5, atUs: nowUs() });
  await page.complete(5);
  await page.until("a reference", (event) => event.type === "reference" && event.reference.camera);

  const before = page.events.length;
  assert.ok(within(page.source.kept, 2));
  page.source.control({ action: "seek", frame: 2, atUs: nowUs() });
  await page.complete(2);
  assert.ok(!page.events.slice(before).some((event) => event.type === "flushed"));

  assert.equal(within(page.source.kept, 9), WHOLE);
  page.source.control({ action: "seek", frame: 9, atUs: nowUs() });
  if (!WHOLE) await page.until("flushed", (event) => event.type === "flushed", before);
  await page.complete(9);
  assert.equal(page.events.slice(before).some((event) => event.type === "flushed"), !WHOLE);

  const lost = page.events.length;
  page.sockets.at(-1)!.close();
  await page.until("a word of the loss", (event) => event.type === "error" && !event.error.fatal, lost);
  const restarted = await page.until("another connection", (event) => event.type === "restarted" && event, lost);
  assert.equal(restarted.resumeAt?.frame, 9);
  await page.complete(9);
  const back = await page.until("status", (event) => event.type === "status" && event.status.link === "open" && event.status, lost + 2);
  assert.equal(back.reconnects, 1);
  assert.equal(back.decodeErrors, 0);
});

test("a display of another shape gets references of its own, and nothing of the scene again", { timeout: 60_000 }, async () => {
  const page = opened();
  await page.until("frame 0", (event) => event.type === "whole" && event.frame === 0);
  page.source.control({ action: "pause", frame: 0, atUs: nowUs() });
  const flat = await page.until("a reference", (event) => event.type === "reference" && event.reference.camera.intrinsics);
  const aspect = ({ widthPx, heightPx, fxPx, fyPx }: Intrinsics): number => (widthPx / fxPx) / (heightPx / fyPx);
  const before = page.events.length;
  page.source.reshape({ widthPx: 300, heightPx: 400, fxPx: 60, fyPx: 60, cxPx: 150, cyPx: 200 });
  const tall = await page.until("one of the new shape", (event) => event.type === "reference" && event.reference.connection === 2 && event.reference.camera.intrinsics, before);
  assert.ok(aspect(flat) > 1.1 && aspect(tall) < 0.9, `${aspect(flat)} and ${aspect(tall)}`);
  await page.complete(0);
  await sleep(600); // a status later
  const bytes = page.told("status").at(-1)!.status.bytesTiles;
  page.onSent = () => {
    page.onSent = () => {};
    page.source.reshape({ ...OPTIONS.intrinsics, fxPx: 70, fyPx: 70 }); // while that is on its way
  };
  page.source.reshape(OPTIONS.intrinsics);
  await page.until("the newest shape", (event) => event.type === "restarted" && event.connection === 4, before);
  await page.complete(0);
  await sleep(600);
  const { status } = page.told("status").at(-1)!;
  assert.deepEqual([status.decodeErrors, status.reconnects, status.bytesTiles], [0, 0, bytes]);
  const since = page.events.slice(before);
  assert.ok(!since.some((event) => event.type === "error" || event.type === "flushed" || (event.type === "status" && event.status.link === "away")));
});

test("a wrong token ends the source with one line", { timeout: 20_000 }, async () => {
  const page = opened({ ...OPTIONS, token: "another" });
  const error = await page.until("an error", (event) => event.type === "error" && event.error);
  assert.equal(error.fatal, true);
  assert.equal(error.code, "token");
  assert.match(error.message, /token/);
});

test("a server that is not there is tried again", { timeout: 20_000 }, async () => {
  const events: SourceEvent[] = [];
  const source = new LiveSource(decoders);
  source.connect("ws://127.0.0.1:9/stream", { ...OPTIONS, reconnectS: 1 }, (event) => events.push(event));
  for (let tries = 0; tries < 300 && !events.some((e) => e.type === "error" && e.error.fatal); tries++) await sleep(20);
  const errors = events.filter((event) => event.type === "error");
  assert.deepEqual(errors.map((event) => event.error.fatal), [false, true]);
  assert.ok(events.some((event) => event.type === "status" && event.status.attempts > 2));
});
