import assert from "node:assert/strict";
import { test } from "node:test";
import { DecodeError } from "../../src/bytes/errors.ts";
import { gunzip, unsqueeze } from "../../src/bytes/inflate.ts";
import { TileCodec } from "../../src/decode/codec.ts";
import type { LooksTile } from "../../src/decode/looks.ts";
import { readManifest } from "../../src/decode/manifest.ts";
import { decodeIds } from "../../src/decode/packing.ts";
import type { Splats } from "../../src/decode/splats.ts";
import type { UpdateTile } from "../../src/decode/updates.ts";
import { MotionTile } from "../../src/motion/chunk.ts";
import { draco, fromBase64, kernels, vectors } from "./vectors.ts";

interface Bundle {
  manifest: Record<string, unknown>;
  codebooks: string;
  tiles: { name: string; payloads: string[]; decoded: Record<string, string>[] }[];
  update: { payloads: string[]; values: Record<string, { ids: string; rows: string }>[] };
}

const wasm = await kernels();
const bundle = vectors<Bundle>("bundle");
const manifest = readManifest(new TextEncoder().encode(JSON.stringify(bundle.manifest)));
const codec = new TileCodec(manifest, fromBase64(bundle.codebooks), wasm, await draco());

function text(array: Float32Array | Int32Array | Uint8Array): string {
  return Buffer.from(array.buffer, array.byteOffset, array.byteLength).toString("base64");
}

function splats(tile: LooksTile): Record<string, string> {
  const columns = Object.entries(tile.dequantise() as unknown as Record<keyof Splats, Float32Array>);
  return { ids: text(tile.ids), ...Object.fromEntries(columns.map(([name, column]) => [name, text(column)])) };
}

for (const { name, payloads, decoded } of bundle.tiles) {
  test(`${name} has the recorded bits at the lowest and the highest level`, () => {
    const [first, ...layers] = payloads.map(fromBase64);
    const tile = codec.open(first!) as LooksTile;
    assert.deepEqual(splats(tile), decoded[0]);
    layers.forEach((layer, i) => tile.addLayer(i + 1, layer));
    assert.equal(tile.lod, layers.length);
    assert.deepEqual(splats(tile), decoded[1]);
  });

  test(`${name} has the same bits however its layers come`, () => {
    const [first, ...layers] = payloads.map(fromBase64);
    const tile = codec.open(first!) as LooksTile;
    for (let i = layers.length; i > 0; i--) tile.addLayer(i, layers[i - 1]!);
    const other = tile.fork();
    assert.deepEqual(splats(tile), decoded[1]);
    assert.deepEqual(splats(other.reduced(1)), decoded[0]);
    assert.deepEqual(splats(tile.reduced(1)), decoded[0]);
  });
}

test("an update has the recorded values", () => {
  const [first, ...layers] = bundle.update.payloads.map(fromBase64);
  const update = codec.open(first!) as UpdateTile;
  const values = (): Record<string, { ids: string; rows: string }> => Object.fromEntries(
    [...update.values()].map(([column, { ids, values: rows }]) => [column, { ids: text(ids), rows: text(rows) }]),
  );
  const sorted = (one: object): unknown => Object.fromEntries(Object.entries(one).sort());
  assert.deepEqual(sorted(values()), sorted(bundle.update.values[0]!));
  layers.forEach((layer, i) => update.addLayer(i + 1, layer));
  assert.deepEqual(sorted(values()), sorted(bundle.update.values[1]!));
});

for (const { name, payloads, arrays } of vectors<{ name: string; payloads: string[]; arrays: Record<string, string> }[]>("chunks")) {
  test(`the chunk of motion '${name}' has the recorded bits, in whatever order its levels come`, () => {
    const [first, ...levels] = payloads.map(fromBase64);
    for (const order of [levels.map((_, i) => i), levels.map((_, i) => levels.length - 1 - i)]) {
      const tile = new MotionTile(first!, wasm);
      for (const i of order) tile.addLayer(i + 1, levels[i]!);
      assert.equal(tile.lod, levels.length);
      for (const [key, wanted] of Object.entries(arrays)) {
        const array = tile.chunk[key as "moves" | "turns" | "lives" | "fades"];
        assert.equal(array ? text(array) : "", wanted, key);
      }
    }
  });
}

test("compressed data and id lists are opened, or refused, as Python does", () => {
  for (const { kind, data, size, plain } of vectors<{ kind: string; data: string; size: number; plain?: string }[]>("bytes")) {
    const given = fromBase64(data);
    const open = (): string => {
      if (kind === "squeeze") return text(unsqueeze(given, size, "it"));
      return kind === "gzip" ? text(gunzip(given, 4000, "it")) : text(decodeIds(given, "it", 6000));
    };
    if (plain === undefined) assert.throws(open, DecodeError, data);
    else assert.equal(open(), plain, data);
  }
});
