// Rows of the scene replaced in part, and the content hashes of what changed. All words are copied as integers: no driver
// flushes a denormal or touches a NaN on the way. Rows are unique; the cost is proportional to their number.
struct Chunk { first: u32, count: u32, unused_a: u32, unused_b: u32 }
struct Update { rows: u32, sh_words: u32, width: u32, unused: u32 }  // width: words of a staged row after its index
@group(0) @binding(0) var<uniform> job: Update;
@group(0) @binding(1) var<uniform> chunk: Chunk;
@group(0) @binding(2) var<storage, read> staged: array<u32>;           // [rows][1 + width]: row, then its words
@group(0) @binding(3) var<storage, read_write> motion: array<u32>;     // 8 words a splat: mean, logit, quaternion
@group(0) @binding(4) var<storage, read_write> looks: array<u32>;      // 8 words a splat: log scale, 0, base colour, its hash
@group(0) @binding(5) var<storage, read_write> sh_rest: array<u32>;    // of the chunk
@group(0) @binding(6) var<storage, read_write> hashes: array<u32>;
override MOTION: bool = true;  // mean, logit and quaternion are staged
override LOOKS: bool = true;   // scale and harmonics are staged
override COLOUR: bool = true;  // the base colour is staged

fn hashed(state: u32, word: u32) -> u32 { return (state ^ word) * 16777619u; }

// FNV-1a over the looks, whose hash is kept: what only moves goes on from there.
fn looks_hash(at: u32, rest: u32) -> u32 {
  var state = 2166136261u;
  for (var k = 0u; k < 3u; k++) { state = hashed(state, looks[at + k]); }
  for (var k = 4u; k < 7u; k++) { state = hashed(state, looks[at + k]); }
  for (var k = 0u; k < job.sh_words; k++) { state = hashed(state, sh_rest[rest + k]); }
  return state;
}

@compute @workgroup_size(256) fn update(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let m = id.y * groups.x * 256u + id.x;
  if (m >= job.rows) { return; }
  var source = m * (1u + job.width);
  let row = staged[source];
  if (row < chunk.first || row >= chunk.first + chunk.count) { return; }
  source++;
  let at = 8u * row;
  let rest = (row - chunk.first) * job.sh_words;
  if (MOTION) {
    for (var k = 0u; k < 8u; k++) { motion[at + k] = staged[source + k]; }
    source += 8u;
  }
  if (LOOKS) {
    for (var k = 0u; k < 3u; k++) { looks[at + k] = staged[source + k]; }
    source += 3u;
  }
  if (COLOUR) {
    for (var k = 0u; k < 3u; k++) { looks[at + 4u + k] = staged[source + k]; }
    source += 3u;
  }
  if (LOOKS) {
    for (var k = 0u; k < job.sh_words; k++) { sh_rest[rest + k] = staged[source + k]; }
  }
  if (LOOKS || COLOUR) { looks[at + 7u] = looks_hash(at, rest); }
  var state = looks[at + 7u];
  for (var k = 0u; k < 3u; k++) { state = hashed(state, motion[at + k]); }
  for (var k = 4u; k < 8u; k++) { state = hashed(state, motion[at + k]); }
  state = hashed(state, motion[at + 3u]);
  state = (state ^ (state >> 15u)) * 0x2C1B3C6Du;  // the finaliser of cags_common.raster.definition.content_hash
  hashes[row] = state ^ (state >> 12u);
}
