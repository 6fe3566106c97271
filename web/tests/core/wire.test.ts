import assert from "node:assert/strict";
import { test } from "node:test";
import { ProtocolError } from "../../src/bytes/errors.ts";
import type { Intrinsics, Pose } from "../../src/seam.ts";
import { DamagedError, decode, encode, VersionError } from "../../src/wire/encoding.ts";
import { packInventory, unpackInventory } from "../../src/wire/inventory.ts";
import type { Message } from "../../src/wire/messages.ts";
import { fromHex, hex, vectors } from "./vectors.ts";

interface Vector {
  data: string;
  refused?: "version" | "damaged" | "protocol";
  type?: string;
  fields?: Record<string, unknown>;
  payload?: string;
}

const messages = vectors<Vector[]>("messages");

/** A value as Python's `asdict` has it. */
function plain(value: unknown): unknown {
  if (value instanceof Uint8Array) return hex(value);
  if (Array.isArray(value)) return value.map(plain);
  if (typeof value === "bigint") return Number(value);
  if (typeof value !== "object" || value === null) return value;
  if ("widthPx" in value) {
    const { widthPx, heightPx, fxPx, fyPx, cxPx, cyPx } = value as Intrinsics;
    return { width_px: widthPx, height_px: heightPx, fx_px: fxPx, fy_px: fyPx, cx_px: cxPx, cy_px: cyPx };
  }
  if ("rotation" in value) return { position: (value as Pose).position, rotation: (value as Pose).rotation };
  return Object.fromEntries(Object.entries(value).map(([key, part]) => [key, plain(part)]));
}

function verdict(data: Uint8Array): string {
  try {
    decode(data);
    return "";
  } catch (error) {
    assert.ok(error instanceof ProtocolError, String(error));
    return error instanceof VersionError ? "version" : error instanceof DamagedError ? "damaged" : "protocol";
  }
}

test("messages that Python reads are read as Python reads them", () => {
  for (const vector of messages.filter((v) => !v.refused)) {
    const { message, payload } = decode(fromHex(vector.data));
    const { type, ...fields } = plain(message) as Record<string, unknown>;
    assert.equal(type, vector.type);
    assert.deepEqual(fields, vector.fields, vector.data);
    assert.equal(hex(payload), vector.payload);
  }
});

test("messages that Python refuses are refused for the same reason", () => {
  for (const vector of messages.filter((v) => v.refused)) assert.equal(verdict(fromHex(vector.data)), vector.refused, vector.data);
});

test("what was read is written to bytes that are read the same", () => {
  let same = 0;
  for (const vector of messages.filter((v) => !v.refused)) {
    const data = fromHex(vector.data);
    const { message, payload } = decode(data);
    const written = encode(message, payload);
    assert.deepEqual(decode(written), { message, payload });
    same += hex(written) === vector.data ? 1 : 0;
  }
  assert.ok(same >= 80, `${same} messages are written byte by byte as Python writes them`);
});

test("inventories are read and refused as Python does", () => {
  for (const { data, tiles } of vectors<{ data: string; tiles?: number[][] }[]>("inventories")) {
    if (!tiles) {
      assert.throws(() => unpackInventory(fromHex(data)), ProtocolError);
      continue;
    }
    const found = unpackInventory(fromHex(data));
    assert.deepEqual(found.map((t) => [t.frame, t.tile, t.lods]), tiles);
    assert.deepEqual(unpackInventory(packInventory(found)).length, tiles.length);
  }
});

test("values that must not travel are refused before they do", () => {
  const bad: Message[] = [
    { type: "ping", t_us: 0.5 },
    { type: "bye", reason: "two\nlines" },
    { type: "poses", samples: [], cadence_permille: 249 },
    { type: "mark", number: -1, restart: false },
  ];
  for (const message of bad) assert.throws(() => encode(message), ProtocolError);
});
