import assert from "node:assert/strict";
import { test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import type { Answer, Request } from "../../src/source/remote.ts";

const told: Answer[] = [];
const host = { postMessage: (answer: Answer) => void told.push(answer), onmessage: null as null | ((event: { data: Request }) => void) };
Object.assign(globalThis, { self: host, fetch: () => Promise.reject(new TypeError("no network")) });
await import("../../src/worker.ts");

async function ask(request: unknown): Promise<Answer | undefined> {
  told.length = 0;
  host.onmessage!({ data: request as Request });
  await sleep(20);
  return told.find((answer) => answer.tell !== "event" || answer.event.type === "error");
}

test("what goes wrong in the worker is told to the page", async () => {
  const early = await ask({ ask: "frame", number: 7, request: { frame: 0 } });
  assert.deepEqual(early, { tell: "failed", number: 7, message: "no frame before the scene is known" });
  const options = { intrinsics: { widthPx: 1, heightPx: 1, fxPx: 1, fyPx: 1, cxPx: 0, cyPx: 0 }, pose: { position: [0, 0, 0], rotation: [1, 0, 0, 0] } };
  const lost = await ask({ ask: "connect", url: "wss://nowhere/stream", options });
  assert.ok(lost?.tell === "event" && lost.event.type === "error" && lost.event.error.code === "decoders" && lost.event.error.fatal);
  await ask({ ask: "connect", url: "https://nowhere/", options });
  const broken = await ask({ ask: "poses", samples: null, cadence: undefined });
  assert.ok(broken?.tell === "event" && broken.event.type === "error" && broken.event.error.code === "worker" && broken.event.error.fatal);
  host.onmessage!({ data: { ask: "close" } });
});
