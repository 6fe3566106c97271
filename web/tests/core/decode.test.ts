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
  base_codebooks: string;
  tiles: { name: string; payloads: string[]; decoded: Record<string, string>[] }[];
  update: { payloads: string[]; values: Record<string, { ids: string; rows: string }>[] };
}

const wasm = await kernels();
const bundle = vectors<Bundle>("bundle");
const manifest = readManifest(new TextEncoder().encode(JSON.stringify(bundle.manifest)));
const decoder = await draco();
const codec = new TileCodec(manifest, fromBase64(bundle.codebooks), wasm, decoder);

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

test("codebooks may begin with base layers", () => {
  const whole = fromBase64(bundle.codebooks);
  const begun = new TileCodec(manifest, fromBase64(bundle.base_codebooks), wasm, decoder);
  const { payloads, decoded } = bundle.tiles[0]!;
  const [first, ...layers] = payloads.map(fromBase64);
  const tile = begun.open(first!) as LooksTile;
  assert.deepEqual(splats(tile), decoded[0]);
  const at = manifest.lodOrder.findIndex((item) => item.attribute !== "position");
  assert.throws(() => tile.addLayer(at + 1, layers[at]!), DecodeError);
  begun.extend(whole);
  layers.forEach((layer, i) => tile.addLayer(i + 1, layer));
  assert.deepEqual(splats(tile), decoded[1]);
  assert.throws(() => begun.extend(fromBase64(bundle.base_codebooks)), /LoD order has/);
});

test("an update has the recorded values", () => {
  const [first, ...layers] = bundle.update.payloads.map(fromBase64);
  const update = codec.open(first!) as UpdateTile;
  const values = (): Record<string, { ids: string; rows: string; frames: string }> => Object.fromEntries(
    [...update.values()].map(([column, { ids, values: rows, frames }]) => [
      column, { ids: text(ids), rows: text(rows), frames: text(frames) },
    ]),
  );
  const sorted = (one: object): unknown => Object.fromEntries(Object.entries(one).sort());
  assert.deepEqual(sorted(values()), sorted(bundle.update.values[0]!));
  layers.forEach((layer, i) => update.addLayer(i + 1, layer));
  assert.deepEqual(sorted(values()), sorted(bundle.update.values[1]!));
});

interface RecordedChunk {
  name: string;
  payloads: string[];
  anchors: { positions: string; moves: string; turns: string };
  /** By level and name. */
  arrays: Record<string, string>;
}

function floats(base64: string): Float32Array {
  return new Float32Array(fromBase64(base64).buffer);
}

for (const { name, payloads, anchors, arrays } of vectors<RecordedChunk[]>("chunks")) {
  test(`the chunk of motion '${name}' has the recorded bits, in whatever order its levels come`, () => {
    const [first, ...levels] = payloads.map(fromBase64);
    const looks = { positions: floats(anchors.positions), moves: floats(anchors.moves), turns: floats(anchors.turns) };
    const check = (tile: MotionTile, level: number): void => {
      for (const key of ["moves", "turns", "lives", "fades"] as const) {
        const array = tile.chunk[key];
        assert.equal(array && text(array), arrays[`${level}-${key}`], `${level}-${key}`);
      }
    };
    const rising = new MotionTile(first!, looks, wasm);
    check(rising, 0);
    levels.forEach((level, i) => {
      rising.addLayer(i + 1, level);
      check(rising, i + 1);
    });
    const falling = new MotionTile(first!, looks, wasm);
    for (let i = levels.length; i > 0; i--) falling.addLayer(i, levels[i - 1]!);
    assert.equal(falling.lod, levels.length);
    check(falling, levels.length);
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
