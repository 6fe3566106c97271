import assert from "node:assert/strict";
import { test } from "node:test";
import { crc32 } from "../../src/bytes/crc32.ts";
import { DecodeError } from "../../src/bytes/errors.ts";
import { TileCodec } from "../../src/decode/codec.ts";
import { readManifest } from "../../src/decode/manifest.ts";
import type { Camera } from "../../src/seam.ts";
import type { GofBuffer } from "../../src/store/gofBuffer.ts";
import { arrivalOf, type Committed, TileStore } from "../../src/store/tileStore.ts";
import { draco, fromBase64, kernels, vectors } from "./vectors.ts";

interface Step {
  op: string;
  [key: string]: unknown;
}

interface Script {
  whole: boolean;
  manifest: string;
  codebooks: string;
  steps: Step[];
}

const COLUMNS = ["means", "quats", "log_scales", "logit_opacities", "sh0", "sh_rest"] as const;
const CAMERA: Camera = {
  intrinsics: { widthPx: 400, heightPx: 300, fxPx: 300, fyPx: 300, cxPx: 200, cyPx: 150 },
  pose: { position: [0, 0, -20], rotation: [1, 0, 0, 0] },
  near: 0.2,
};

function bytes(array: Float32Array): Uint8Array {
  return new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
}

function shown(store: TileStore, gof: GofBuffer, committed: Committed): Record<string, unknown> {
  const { lod, error } = gof.detailIn(CAMERA);
  return {
    columns: Object.fromEntries(COLUMNS.map((name) => [name, crc32(bytes(gof.buffer.column(name)))])),
    owners: crc32(Uint8Array.from(gof.buffer.owner, (owner) => (owner >= 0 ? 1 : 0))),
    rows: [...committed.rows],
    began: [...committed.began],
    moved: [...committed.moved],
    flags: [committed.gof, committed.fresh, committed.missed, gof.full, ...store.kept],
    held: store.held().map((t) => [t.frame, t.tile, t.lods]).sort((a, b) => a[0]! - b[0]! || a[1]! - b[1]!),
    ahead: store.ahead(0),
    dropped: store.takeDropped().length,
    lodMean: Number.isNaN(lod) ? null : lod,
    ownError: Number.isNaN(error) ? null : error,
  };
}

/** One step; what is there after it. */
function taken(store: TileStore, step: Step): Record<string, unknown> {
  const frame = step["frame"] as number;
  switch (step.op) {
    case "add": {
      const arrivals = (step["arrivals"] as { frame: number; tile: number; from: number; payloads: string[] }[]);
      const errors = store.add(arrivals.map((a) => arrivalOf(a.frame, a.tile, a.from, a.payloads.map(fromBase64))));
      return { arrivals, errors: errors.length };
    }
    case "flush": return { errors: store.flush().length };
    case "mark": return { number: step["number"], errors: store.mark(step["number"] as number).length };
    case "end": return { frame, removed: step["removed"], errors: ended(store, frame, step["removed"] as number[]) };
    case "reset": {
      store.reset(frame);
      return { frame };
    }
    case "restarted": {
      const inventory = step["inventory"] as [number, number, number][] | null;
      store.restarted(inventory?.map(([f, tile, lods]) => ({ frame: f, tile, lods })));
      return { inventory };
    }
    case "commit": {
      const basis = step["basis"] as number | null;
      return { frame, basis, ...shown(store, ...store.commit(frame, basis ?? undefined)) };
    }
    default: {
      const share = step["share"] as number;
      const moved = store.move(frame, share);
      return { frame, share, ...(moved ? shown(store, ...moved) : { none: true }) };
    }
  }
}

function ended(store: TileStore, frame: number, removed: number[]): number {
  try {
    store.end(frame, Int32Array.from(removed));
    return 0;
  } catch (error) {
    assert.ok(error instanceof DecodeError);
    return 1;
  }
}

test("after every step the store shows what Python's shows", async () => {
  const [wasm, decoder] = [await kernels(), await draco()];
  for (const [i, script] of vectors<Script[]>("scripts").entries()) {
    const read = readManifest(new TextEncoder().encode(script.manifest));
    const manifest = { ...read, keptWhole: read.keptWhole && (script.whole || read.gofStarts.length === 1) };
    const codec = new TileCodec(manifest, fromBase64(script.codebooks), wasm, decoder);
    const store = new TileStore(manifest, codec);
    for (const [at, step] of script.steps.entries()) {
      const { lodMean, ownError, ...after } = taken(store, step);
      const { op: _op, lodMean: wanted, ownError: wantedError, ...rest } = step;
      assert.deepEqual(after, rest, `script ${i}, step ${at}: ${step.op}`);
      if (typeof wanted === "number") assert.ok(Math.abs((lodMean as number) - wanted) < 1e-6, `lodMean ${lodMean}, ${wanted}`);
      else assert.ok(lodMean === null || lodMean === undefined);
      if (typeof wantedError === "number") assert.ok(Math.abs((ownError as number) / wantedError - 1) < 1e-6, `ownError ${ownError}, ${wantedError}`);
      else assert.ok(ownError === null || ownError === undefined);
    }
    store.dispose();
    codec.dispose();
  }
});
