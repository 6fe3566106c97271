import assert from "node:assert/strict";
import { test } from "node:test";
import type { FrameUpdate, SourceEvent } from "../../src/seam.ts";
import { type Answer, type Port, RemoteSource, type Request } from "../../src/source/remote.ts";

/** A worker that does nothing by itself. */
class Silent implements Port {
  readonly asked: Request[] = [];
  onmessage: Port["onmessage"] = null;
  onerror: Port["onerror"] = null;
  postMessage(message: Request, transfer: Transferable[] = []): void {
    this.asked.push(structuredClone(message, { transfer }));
  }
  terminate(): void {}
  answer(data: Answer): void {
    this.onmessage!({ data } as MessageEvent<Answer>);
  }
}

const update = { frame: 3 } as FrameUpdate;

test("memory goes back to the worker with the next question", async () => {
  const port = new Silent();
  const source = new RemoteSource(port);
  const block = new ArrayBuffer(64);
  const coming = source.frame({ frame: 3, spent: [block] });
  assert.equal(block.byteLength, 0, "it is the worker's now");
  const [asked] = port.asked as [Extract<Request, { ask: "frame" }>];
  assert.deepEqual(asked.request.spent!.map(({ byteLength }) => byteLength), [64]);
  port.answer({ tell: "frame", number: asked.number, update, kept: [0, 5] });
  assert.equal(await coming, update);
});

test("a frame that fails is told to whoever asked for it, and no other", async () => {
  const port = new Silent();
  const source = new RemoteSource(port);
  const [first, second] = [source.frame({ frame: 0 }), source.frame({ frame: 1 })];
  port.answer({ tell: "failed", number: 1, message: "no such frame" });
  port.answer({ tell: "frame", number: 2, update, kept: [0, 5] });
  await assert.rejects(first, /no such frame/);
  assert.equal(await second, update);
});

test("a worker that breaks ends what waits, and says why", async () => {
  const port = new Silent();
  const source = new RemoteSource(port);
  const events: SourceEvent[] = [];
  source.connect("wss://x/stream", {} as Parameters<RemoteSource["connect"]>[1], (event) => events.push(event));
  const waiting = source.frame({ frame: 0 });
  port.onerror!({ message: "out of memory" } as ErrorEvent);
  await assert.rejects(waiting, /out of memory/);
  assert.deepEqual(events, [{ type: "error", error: { code: "worker", message: "out of memory", fatal: true } }]);
});

test("who leaves does not wait for an answer that may never come", async () => {
  const port = new Silent();
  const source = new RemoteSource(port);
  const waiting = source.frame({ frame: 0 });
  source.close();
  source.close();
  await assert.rejects(waiting, /has left/);
  await assert.rejects(source.frame({ frame: 1 }), /has left/);
  assert.deepEqual(port.asked.map(({ ask }) => ask), ["frame", "close"]);
});
