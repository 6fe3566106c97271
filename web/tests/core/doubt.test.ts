import assert from "node:assert/strict";
import { test } from "node:test";
import { doubted } from "../../src/playback/doubt.ts";
import { vectors } from "./vectors.ts";

interface Case {
  error: number;
  own: number | null;
  taken: number;
}

test("a picture is believed as far as by Python's client", () => {
  for (const { error, own, taken } of vectors<Case[]>("cases")) {
    assert.ok(Math.abs(doubted(error, own ?? NaN) - taken) <= 1e-9 * taken, `${error} beside ${own}`);
  }
});
