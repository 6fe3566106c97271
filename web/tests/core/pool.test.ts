import assert from "node:assert/strict";
import { test } from "node:test";
import { BufferPool } from "../../src/bytes/pool.ts";

const words = (count: number, first = 0): Uint32Array => Uint32Array.from({ length: count }, (_, i) => first + i);

test("a block that was given back holds the next values, and nothing of the last ones shows", () => {
  const pool = new BufferPool();
  const before = pool.copy(words(50_000));
  pool.give([before.buffer]);
  const after = pool.copy(words(49_000, 7));
  assert.equal(after.buffer, before.buffer);
  assert.deepEqual(after, words(49_000, 7));
  assert.notEqual(pool.copy(words(49_000)).buffer, before.buffer, "it is given once");
});

test("values that fit into no block have one of their own", () => {
  const pool = new BufferPool();
  const small = pool.copy(words(10)).buffer;
  pool.give([small]);
  assert.notEqual(pool.copy(words(1_000_000)).buffer, small);
  assert.equal(pool.copy(words(11)).buffer, small, "which stays for those that fit");
});

test("small values do not take large blocks", () => {
  const pool = new BufferPool();
  const large = pool.copy(words(4_000_000)).buffer;
  pool.give([large]);
  assert.notEqual(pool.copy(words(10)).buffer, large);
});

test("few blocks are kept, and none that was transferred away", () => {
  const pool = new BufferPool();
  const made = Array.from({ length: 40 }, () => pool.copy(words(20_000)).buffer);
  structuredClone(made[39], { transfer: [made[39]!] });
  pool.give(made);
  const kept = made.filter(() => made.includes(pool.copy(words(20_000)).buffer));
  assert.equal(kept.length, 4);
});
