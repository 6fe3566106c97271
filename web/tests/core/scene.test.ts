import assert from "node:assert/strict";
import { test } from "node:test";
import type { Manifest } from "../../src/decode/manifest.ts";
import { memoryMb, tooLarge } from "../../src/source/scene.ts";

/** What a browser on a device of so many GB says. */
function on(deviceMemory: number | undefined, check: () => void): void {
  const before = Object.getOwnPropertyDescriptor(globalThis, "navigator");
  Object.defineProperty(globalThis, "navigator", { value: deviceMemory === undefined ? {} : { deviceMemory }, configurable: true });
  try {
    check();
  } finally {
    if (before) Object.defineProperty(globalThis, "navigator", before);
    else Reflect.deleteProperty(globalThis, "navigator");
  }
}

test("a page gives half of the device's memory", () => {
  for (const [gb, mb] of [[undefined, 2048], [0.25, 512], [2, 1024], [8, 4096], [32, 4096]] as const) {
    on(gb, () => assert.equal(memoryMb(), mb, `${gb} GB`));
  }
});

test("what is larger is refused in one line, before anything is allocated", () => {
  const manifest = { capacity: [1000, 2_500_000], shDegree: 3 } as unknown as Manifest;
  assert.equal(tooLarge(manifest, 4_000_000, 4096), undefined);
  assert.match(tooLarge(manifest, 4_000_000, 2048)!, /2500000 splats, which take 2655 MB; this viewer gives 2048/);
  assert.match(tooLarge(manifest, 2_000_000, 4096)!, /2500000 splats, and this viewer takes 2000000/);
});
