import assert from "node:assert/strict";
import { test } from "node:test";
import { readManifest } from "../../src/decode/manifest.ts";
import { SceneStore } from "../../src/source/scene.ts";
import { arrivalOf } from "../../src/store/tileStore.ts";
import { draco, fromBase64, kernels, vectors } from "./vectors.ts";

interface Scene {
  manifest: string;
  codebooks: string;
  looks: string[];
  motions: string[][];
}

const ROUNDS = 40;

test("a frame in which every splat moves", async () => {
  const { manifest, codebooks, looks, motions } = vectors<Scene>("scene");
  const info = readManifest(new TextEncoder().encode(manifest));
  const scene = new SceneStore(info, { kernels: await kernels(), draco: await draco() }, 0);
  scene.codebooks(fromBase64(codebooks));
  const begun = process.cpuUsage();
  const arrivals = looks.map((payload, tile) => arrivalOf(0, tile, 0, [fromBase64(payload)]));
  assert.deepEqual(scene.add(arrivals), []);
  const decodedLooks = process.cpuUsage(begun);
  const chunks = motions.map((levels, i) => arrivalOf(0, looks.length + i, 0, levels.map(fromBase64)));
  const before = process.cpuUsage();
  assert.deepEqual(scene.add(chunks), []);
  const decodedMotion = process.cpuUsage(before);
  for (let frame = 0; frame < info.frames; frame++) scene.end(frame, new Uint8Array(0));
  const splats = info.capacity[0]!;
  assert.equal(scene.frame({ frame: 0 }, undefined).patches[0]!.rows, splats);
  for (let i = 0; i < 30; i++) scene.frame({ frame: 0, share: 0.1 + i / 100 }, undefined); // warm
  const times: number[] = [];
  let bytes = 0;
  let spent: ArrayBuffer[] = [];
  for (let round = 0; round < ROUNDS; round++) {
    const start = process.cpuUsage();
    for (const share of [0.13, 0.37, 0.61, 0.89]) {
      const { patches, movedRows } = scene.frame({ frame: 0, share: share + round / 1000, spent }, undefined);
      assert.equal(movedRows, splats);
      const { words } = patches[0]!;
      if (spent.length) assert.equal(words.buffer, spent[0], "no memory is taken anew");
      bytes = words.byteLength;
      spent = [words.buffer];
    }
    const { user, system } = process.cpuUsage(start);
    times.push((user + system) / 4000);
  }
  times.sort((a, b) => a - b);
  const ms = (usage: NodeJS.CpuUsage): string => ((usage.user + usage.system) / 1000).toFixed(0);
  console.log(
    `RESULT ${splats} moving splats: median ${times[ROUNDS / 2]!.toFixed(2)} ms of CPU a frame (10 % ${times[4]!.toFixed(2)}, ` +
      `90 % ${times[36]!.toFixed(2)}), ${bytes} bytes to the GPU; decoding looks ${ms(decodedLooks)} ms, motion ${ms(decodedMotion)} ms`,
  );
});
