// A stable radix sort of (key, value) pairs, 8 bits a pass, without subgroups, in 10 KiB of workgroup memory.
// Blocks of 2048 pairs: count -> scan (a workgroup a digit) -> scatter. `count` says how many pairs there are, or, where
// only the device knows, `state[1]` does.
struct Sort { shift: u32, count: u32, blocks: u32, counted: u32 }  // blocks: length of the histogram's rows
@group(0) @binding(0) var<uniform> job: Sort;
@group(0) @binding(1) var<storage, read> state: array<u32>;
@group(0) @binding(2) var<storage, read> keys_in: array<u32>;
@group(0) @binding(3) var<storage, read> values_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> values_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> histogram: array<u32>;  // [256][blocks], then a total a digit
const BLOCK = 2048u;
const ROUNDS = 8u;

fn pairs() -> u32 { return select(job.count, state[1], job.counted != 0u); }

fn blocks_in_use() -> u32 { return (pairs() + BLOCK - 1u) / BLOCK; }

var<workgroup> digits: array<atomic<u32>, 256>;

@compute @workgroup_size(256) fn count(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  let n = pairs();
  atomicStore(&digits[lane], 0u);
  workgroupBarrier();
  for (var k = 0u; k < ROUNDS; k++) {
    let i = group.x * BLOCK + k * 256u + lane;
    if (i < n) { atomicAdd(&digits[(keys_in[i] >> job.shift) & 255u], 1u); }
  }
  workgroupBarrier();
  if (group.x < job.blocks) { histogram[lane * job.blocks + group.x] = atomicLoad(&digits[lane]); }
}

var<workgroup> sums: array<u32, 256>;

// Inclusive scan over the workgroup of one number a thread.
fn scanned(lane: u32, value: u32) -> u32 {
  sums[lane] = value;
  workgroupBarrier();
  for (var step = 1u; step < 256u; step *= 2u) {
    var before = 0u;
    if (lane >= step) { before = sums[lane - step]; }
    workgroupBarrier();
    sums[lane] += before;
    workgroupBarrier();
  }
  return sums[lane];
}

// Exclusive scan of one digit's row in place; its total goes behind the rows.
@compute @workgroup_size(256) fn scan(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  let blocks = blocks_in_use();
  let row = group.x * job.blocks;
  let each = (blocks + 255u) / 256u;
  let begin = min(lane * each, blocks); let end = min(begin + each, blocks);
  var sum = 0u;
  for (var i = begin; i < end; i++) { sum += histogram[row + i]; }
  let upto = scanned(lane, sum);
  var at = upto - sum;
  for (var i = begin; i < end; i++) { let here = histogram[row + i]; histogram[row + i] = at; at += here; }
  if (lane == 255u) { histogram[256u * job.blocks + group.x] = upto; }
}

var<workgroup> present: array<atomic<u32>, 2048>;  // [8][256] bits of the threads that hold a digit
var<workgroup> next: array<u32, 256>;              // where a digit's next pair goes

@compute @workgroup_size(256) fn scatter(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  let n = pairs();
  let total = histogram[256u * job.blocks + lane];
  next[lane] = scanned(lane, total) - total + histogram[lane * job.blocks + group.x];
  for (var w = 0u; w < 8u; w++) { atomicStore(&present[w * 256u + lane], 0u); }
  workgroupBarrier();
  let word = (lane / 32u) * 256u; let bit = lane % 32u;
  for (var k = 0u; k < ROUNDS; k++) {
    let i = group.x * BLOCK + k * 256u + lane;
    var key = 0u; var digit = 0u;
    if (i < n) {
      key = keys_in[i];
      digit = (key >> job.shift) & 255u;
      atomicOr(&present[word + digit], 1u << bit);
    }
    workgroupBarrier();
    if (i < n) {
      var to = next[digit] + countOneBits(atomicLoad(&present[word + digit]) & ((1u << bit) - 1u));
      for (var w = digit; w < word; w += 256u) { to += countOneBits(atomicLoad(&present[w])); }
      keys_out[to] = key;
      values_out[to] = values_in[i];
    }
    workgroupBarrier();
    for (var w = lane; w < 2048u; w += 256u) {
      next[lane] += countOneBits(atomicLoad(&present[w]));
      atomicStore(&present[w], 0u);
    }
    workgroupBarrier();
  }
}
