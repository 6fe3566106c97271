import assert from "node:assert/strict";
import { test } from "node:test";
import { Startup, STARTUP_US } from "../../src/player/startup.ts";
import { vectors } from "./vectors.ts";

interface Step {
  op: "came" | "whole" | "preview";
  now: number;
  tile: boolean;
  equipped: boolean;
  said: boolean | null;
  ends: number | null;
}

test("the first frame is held by Python's rule", () => {
  const { longest, plays } = vectors<{ longest: number; plays: { most: number; begun: number; steps: Step[] }[] }>("holds");
  assert.equal(STARTUP_US, longest);
  for (const { most, begun, steps } of plays) {
    const startup = new Startup(most, begun);
    for (const { op, now, tile, equipped, said, ends } of steps) {
      assert.equal((op === "came" ? startup.came(now, tile, equipped) : startup[op](now)) ?? null, said);
      assert.equal(startup.endsUs ?? null, ends);
    }
  }
});
