// Stage 3: the tiles of each splat, front to back: counts -> exclusive scan -> entries (tile, value). After a stable sort
// by tile each tile's entries lie front to back. The value is the splat; where contributions are summed, the entry's slot.
@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> touched: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;             // splats front to back
@group(0) @binding(3) var<storage, read_write> sums: array<u32>;        // of blocks of 256 splats
@group(0) @binding(4) var<storage, read_write> state: array<u32>;       // 0: splats, 1: entries, 2: wanted, 3: most wanted since cleared
@group(0) @binding(5) var<storage, read_write> dispatch: array<u32>;    // workgroups: [0..2] of 2048, [3..5] of 256 entries
@group(0) @binding(6) var<storage, read> records: array<vec4<u32>>;
@group(0) @binding(7) var<storage, read_write> entry_tile: array<u32>;
@group(0) @binding(8) var<storage, read_write> entry_value: array<u32>;
@group(0) @binding(9) var<storage, read_write> slot_splat: array<u32>;
override SLOTS: bool = false;
const BLOCK = 256u;      // splats of a workgroup: one per thread, because a large splat writes thousands of entries
const SORTED = 2048u;    // entries of a workgroup of the sort
var<workgroup> part: array<u32, 256>;

fn tiles_of(rank: u32) -> u32 {
  if (rank >= view.count) { return 0u; }
  return touched[order[rank]];
}

// Inclusive scan over the workgroup of one number a thread.
fn scanned(lane: u32, value: u32) -> u32 {
  part[lane] = value;
  workgroupBarrier();
  for (var step = 1u; step < 256u; step *= 2u) {
    var before = 0u;
    if (lane >= step) { before = part[lane - step]; }
    workgroupBarrier();
    part[lane] += before;
    workgroupBarrier();
  }
  return part[lane];
}

// Sums stop at the largest number: what overflows stays more than any capacity.
fn added(a: u32, b: u32) -> u32 { return select(a + b, 0xffffffffu, a + b < a); }

@compute @workgroup_size(256) fn count(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  let upto = scanned(lane, tiles_of(group.x * BLOCK + lane));
  if (lane == 255u) { sums[group.x] = upto; }
}

// Exclusive scan of the blocks' sums in place; one workgroup.
@compute @workgroup_size(256) fn scan(@builtin(local_invocation_index) lane: u32) {
  let blocks = (view.count + BLOCK - 1u) / BLOCK;
  let each = (blocks + 255u) / 256u;
  let begin = min(lane * each, blocks); let end = min(begin + each, blocks);
  var sum = 0u;
  for (var i = begin; i < end; i++) { sum = added(sum, sums[i]); }
  part[lane] = sum;
  workgroupBarrier();
  var at = 0u;
  for (var k = 0u; k < lane; k++) { at = added(at, part[k]); }
  let upto = added(at, sum);
  for (var i = begin; i < end; i++) { let here = sums[i]; sums[i] = at; at = added(at, here); }
  if (lane == 255u) {
    let entries = min(upto, view.capacity);
    state[0] = view.count;
    state[1] = entries;
    state[2] = upto;
    state[3] = max(state[3], upto);
    dispatch[0] = (entries + SORTED - 1u) / SORTED; dispatch[1] = 1u; dispatch[2] = 1u;
    dispatch[3] = min((entries + 255u) / 256u, 65535u); dispatch[4] = 1u; dispatch[5] = 1u;
  }
}

fn put(at: u32, tile: u32, splat: u32) {
  if (at >= view.capacity) { return; }
  entry_tile[at] = tile;
  if (SLOTS) {
    entry_value[at] = at;
    slot_splat[at] = splat;
  } else {
    entry_value[at] = splat;
  }
}

// As many entries as `project` counted: two pipelines need not round alike, so what is short is filled up with a tile that
// does not exist, and what is over is left out.
fn emitted(splat: u32, from_slot: u32, count: u32) {
  let drawn = drawn_of(records[2u * splat], records[2u * splat + 1u]);
  let rows = tile_rows(drawn, view.size);
  let before = splat / view.splats * view.tiles.x * view.tiles.y;  // tiles of the layers before
  var at = from_slot;
  let end = added(from_slot, count);
  for (var row = rows.x; row <= rows.y; row++) {
    let columns = tile_columns(drawn, row, view.size);
    for (var column = columns.x; column <= columns.y && at < end; column++) {
      put(at, before + u32(row) * view.tiles.x + u32(column), splat);
      at++;
    }
  }
  for (; at < end; at++) { put(at, view.layers * view.tiles.x * view.tiles.y, splat); }
}

@compute @workgroup_size(256) fn emit(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  let rank = group.x * BLOCK + lane;
  let tiles = tiles_of(rank);
  let at = added(sums[group.x], scanned(lane, tiles) - tiles);
  if (tiles > 0u && at < view.capacity) { emitted(order[rank], at, tiles); }
}
