import assert from "node:assert/strict";
import { test } from "node:test";
import { isPacked, type Packed, rgbOfPacked } from "../../src/video/colour.ts";
import { vectors } from "./vectors.ts";

const cases = vectors<{ format: Packed["format"]; width: number; height: number; offset: number; stride: number; data: number[]; rgb: number[] }[]>("pictures");

test("a picture that the browser made RGB of keeps its channels, whatever their order and the rows' padding", () => {
  for (const { format, width, height, offset, stride, data, rgb } of cases) {
    assert.ok(isPacked(format));
    const made = rgbOfPacked({ width, height, data: Uint8Array.from(data), layout: [{ offset, stride }], format });
    assert.deepEqual(made, Float32Array.from(rgb, (value) => value / 255), format);
  }
  assert.ok(cases.length >= 4);
});

test("planes, and formats that nobody knows, are not taken for it", () => {
  for (const format of ["I444", "I420", "NV12", "I420A", "toString", null]) assert.ok(!isPacked(format), String(format));
});
