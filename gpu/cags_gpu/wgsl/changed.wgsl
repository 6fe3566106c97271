// Where the client's view shows splats that changed since a reference was made: a veto a cell of 16 x 16 pixels
// (cags_common.correction.changed). Depths are told apart by slabs, equal in their logarithm, over those of the view.
struct Changed {
  size: vec2<u32>, grid: vec2<u32>,  // pixels; cells
  count: u32, behind: f32, stale: f32, unused: u32,
}
@group(0) @binding(0) var<uniform> job: Changed;
@group(0) @binding(1) var<storage, read> depth: array<u32>;                 // bits of a float; +inf where void or thin
@group(0) @binding(2) var<storage, read> boxes: array<vec4<u32>>;           // first and last row, and column, of cells in 16 bits each; bits of the near side's depth
@group(0) @binding(3) var<storage, read_write> reach: array<atomic<u32>>;   // of the known depths' bits the largest complement, and the largest
@group(0) @binding(4) var<storage, read_write> veto: array<f32>;            // [grid.y][grid.x]
const CELL = 16u;
const SAMPLED = 4u;      // every how many pixels are looked at for the range of depths
const EDGES = 31.0;      // between the slabs
const BEYOND = 1.5;      // the last edge, of the farthest depth
const VOID = 0x7f800000u;

var<workgroup> least: atomic<u32>;
var<workgroup> most: atomic<u32>;

@compute @workgroup_size(16, 16) fn measure(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  if (lane == 0u) { atomicStore(&least, 0u); atomicStore(&most, 0u); }
  workgroupBarrier();
  let pixel = id.xy * SAMPLED;
  if (all(pixel < job.size)) {
    let bits = depth[pixel.y * job.size.x + pixel.x];
    if (bits > 0u && bits < VOID) { atomicMax(&least, ~bits); atomicMax(&most, bits); }
  }
  workgroupBarrier();
  if (lane == 0u) { atomicMax(&reach[0], atomicLoad(&least)); atomicMax(&reach[1], atomicLoad(&most)); }
}

// How many edges between slabs are no further than depth z.
fn slab(z: f32, low: f32, high: f32) -> f32 {
  if (z < low) { return 0.0; }
  return min(floor((EDGES - 1.0) * log2(z / low) / log2(high / low)) + 1.0, EDGES);
}

var<workgroup> farthest: atomic<u32>;
var<workgroup> seen: atomic<u32>;

@compute @workgroup_size(16, 16) fn veto_cells(
  @builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) cell: vec3<u32>, @builtin(local_invocation_index) lane: u32
) {
  if (lane == 0u) { atomicStore(&farthest, 0u); atomicStore(&seen, 0u); }
  workgroupBarrier();
  if (all(id.xy < job.size)) { atomicMax(&farthest, depth[id.y * job.size.x + id.x]); }
  workgroupBarrier();
  let known = atomicLoad(&reach[1]) > 0u;
  let low = select(1.0, bitcast<f32>(~atomicLoad(&reach[0])), known);
  let high = BEYOND * select(1.0, bitcast<f32>(atomicLoad(&reach[1])), known);
  let bits = atomicLoad(&farthest);
  var front = EDGES;
  if (bits > 0u && bits < VOID) { front = slab(bitcast<f32>(bits) * (1.0 + job.behind), low, high); }
  for (var k = lane; k < job.count; k += 256u) {
    let b = boxes[k];
    let inside = cell.y >= (b.x & 0xffffu) && cell.y <= (b.x >> 16u) && cell.x >= (b.y & 0xffffu) && cell.x <= (b.y >> 16u);
    if (inside && slab(bitcast<f32>(b.z), low, high) <= front) { atomicStore(&seen, 1u); }
  }
  workgroupBarrier();
  if (lane == 0u) { veto[cell.y * job.grid.x + cell.x] = max(f32(atomicLoad(&seen)), job.stale); }
}
