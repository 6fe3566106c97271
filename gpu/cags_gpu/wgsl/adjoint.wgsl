// The adjoint of compositing: a residual picture carried back onto the splats with the weights that they blend by. Sums are
// integers, so the result depends on no order: weights in 2^-22 pixels, residuals in the same of the picture's largest.
@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> records: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> entry_value: array<u32>;
@group(0) @binding(3) var<storage, read> slot_splat: array<u32>;
@group(0) @binding(4) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read> residual: array<f32>;              // [H][W][3], in [-1, 1]
@group(0) @binding(6) var<storage, read_write> slots: array<vec4<i32>>;     // weighted residual and weight of each entry
const BATCH = 256u;
const UNIT = 4194304.0;
var<workgroup> batch_a: array<vec4<f32>, BATCH>;
var<workgroup> batch_b: array<vec4<f32>, BATCH>;
var<workgroup> sums: array<atomic<i32>, 1024>;
var<workgroup> open: atomic<u32>;
var<workgroup> going_on: u32;

@compute @workgroup_size(16, 16)
fn adjoint(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  let pixel = tile.xy * TILE + local.xy;
  let inside = all(pixel < view.size);
  let range = ranges[tile.y * view.tiles.x + tile.x];
  var error = vec3(0.0);
  if (inside) {
    let i = 3u * (pixel.y * view.size.x + pixel.x);
    error = vec3(residual[i], residual[i + 1u], residual[i + 2u]) * UNIT;
  }
  var light = 1.0;
  var finished = !inside;
  for (var begin = range.x; begin < range.y; begin += BATCH) {
    if (lane == 0u) { atomicStore(&open, 0u); }
    workgroupBarrier();
    if (!finished) { atomicOr(&open, 1u); }
    workgroupBarrier();
    if (lane == 0u) { going_on = atomicLoad(&open); }
    if (workgroupUniformLoad(&going_on) == 0u) { break; }
    let count = min(BATCH, range.y - begin);
    if (lane < count) {
      let splat = slot_splat[entry_value[begin + lane]];
      let drawn = drawn_of(records[2u * splat], records[2u * splat + 1u]);
      batch_a[lane] = vec4(drawn.centre, drawn.l11, drawn.l12);
      batch_b[lane] = vec4(drawn.l22, drawn.strength, drawn.rest);
      for (var c = 0u; c < 4u; c++) { atomicStore(&sums[4u * lane + c], 0); }
    }
    workgroupBarrier();
    for (var k = 0u; k < count && !finished; k++) {
      let a = batch_a[k]; let b = batch_b[k];
      let d = (vec2<f32>(pixel) + 0.5 - a.xy) - b.zw;
      let s = a.z * d.x + a.w * d.y; let t = b.x * d.y;
      let power = b.y - s * s - t * t;
      if (!(power >= LOG2_ALPHA_CUT)) { continue; }
      let weight = light * min(ALPHA_MAX, exp2(power));
      light -= weight;
      let carried = vec3<i32>(round(weight * error));
      atomicAdd(&sums[4u * k], carried.x);
      atomicAdd(&sums[4u * k + 1u], carried.y);
      atomicAdd(&sums[4u * k + 2u], carried.z);
      atomicAdd(&sums[4u * k + 3u], i32(weight * UNIT + 0.5));
      finished = light <= view.stop;
    }
    workgroupBarrier();
    if (lane < count) {
      let at = 4u * lane;
      slots[entry_value[begin + lane]] =
        vec4(atomicLoad(&sums[at]), atomicLoad(&sums[at + 1u]), atomicLoad(&sums[at + 2u]), atomicLoad(&sums[at + 3u]));
    }
  }
}
