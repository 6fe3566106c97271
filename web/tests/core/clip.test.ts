import assert from "node:assert/strict";
import { test } from "node:test";
import { readManifest } from "../../src/decode/manifest.ts";
import { SceneStore } from "../../src/source/scene.ts";
import { arrivalOf } from "../../src/store/tileStore.ts";
import { draco, fromBase64, kernels, vectors } from "./vectors.ts";

interface Clip {
  manifest: string;
  codebooks: string;
  frames: { tiles: string[][] }[];
  /** Of each frame after the first: rows that only moved, and that changed. */
  told: [number, number][];
}

const PASSES = 4;

test("what the frames of a clip take, and what of them goes to the device", async () => {
  const { manifest, codebooks, frames, told } = vectors<Clip>("clip");
  const info = readManifest(new TextEncoder().encode(manifest));
  const decoders = { kernels: await kernels(), draco: await draco() };
  const decoded = (): SceneStore => {
    const scene = new SceneStore(info, decoders, 0);
    scene.codebooks(fromBase64(codebooks));
    frames.forEach(({ tiles }, frame) => {
      const arrivals = tiles.map((levels, tile) => arrivalOf(frame, tile, 0, levels.map(fromBase64)));
      assert.deepEqual(scene.add(arrivals), []);
      scene.end(frame, new Uint8Array(0)); // lives say when splats of clips with motion end
    });
    return scene;
  };
  const costs: { media: number; between: number }[] = [];
  let [rows, bytes, changed] = [0, 0, 0];
  for (let pass = 0; pass < PASSES; pass++) {
    const scene = decoded();
    [rows, bytes, changed] = [0, 0, 0];
    let [media, between] = [0, 0];
    const spent = (share?: number, frame = 0): number => {
      const start = process.cpuUsage();
      const { patches, movedRows, changedRows } = scene.frame({ frame, ...(share ? { share } : {}) }, undefined);
      const { user, system } = process.cpuUsage(start);
      if (!share && frame) {
        assert.deepEqual([movedRows, changedRows], told[frame - 1]);
        rows += movedRows;
        changed += changedRows;
        bytes += patches.reduce((sum, patch) => sum + patch.words.byteLength, 0);
      }
      return (user + system) / 1000;
    };
    spent();
    for (let frame = 1; frame < info.frames; frame++) {
      media += spent(undefined, frame);
      between += spent(0.5, frame);
    }
    scene.dispose();
    costs.push({ media: media / (info.frames - 1), between: between / (info.frames - 1) });
  }
  const least = (of: "media" | "between"): string => Math.min(...costs.slice(1).map((cost) => cost[of])).toFixed(2);
  const each = (sum: number): string => (sum / (info.frames - 1)).toFixed(0);
  console.log(
    `RESULT ${Math.max(...info.capacity)} splats: ${each(rows)} only moved and ${each(changed)} changed a frame, ${each(bytes)} bytes to the ` +
      `device; ${least("media")} ms of CPU a media frame, ${least("between")} a picture between two`,
  );
});
