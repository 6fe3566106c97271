import assert from "node:assert/strict";
import { test } from "node:test";
import { type Between, newestDue, nextDue, Quality } from "../../src/player/quality.ts";
import { vectors } from "./vectors.ts";

interface Step {
  /** What is done first: another wish, another period or refresh, a restart. */
  wish: [number[], Between] | null;
  period: number;
  display: number;
  restart: boolean;
  now: number;
  took: number;
  pixels: number;
  media: boolean;
  /** What was chosen after it. */
  scale: number;
  permille: number;
  step: number | null;
  fits: [number, boolean];
}

test("the page decides as Python's client does, picture by picture", () => {
  const plays = vectors<{ scales: number[]; display: number; skips: boolean; steps: Step[] }[]>("plays");
  for (const { scales, display, skips, steps } of plays) {
    const quality = new Quality(scales, display, skips);
    for (const [number, step] of steps.entries()) {
      if (step.wish) quality.wish(...step.wish);
      quality.periodUs = step.period;
      quality.displayUs = step.display;
      if (step.restart) quality.restart();
      quality.observe(step.now, step.took, step.pixels, step.media);
      const chosen = [quality.scale, quality.permille, quality.stepUs ?? null, quality.fits(step.now, step.fits[0])];
      assert.deepEqual(chosen, [step.scale, step.permille, step.step, step.fits[1]], `picture ${number}`);
    }
  }
});

test("ticks are chosen by Python's rule", () => {
  for (const { tick, end, permille, now, next, newest } of vectors<Record<"tick" | "end" | "permille" | "now" | "next" | "newest", number>[]>("ticks")) {
    assert.equal(nextDue(tick, end, permille), next);
    assert.equal(newestDue(next, end, permille, (each) => each <= now), newest);
  }
});
