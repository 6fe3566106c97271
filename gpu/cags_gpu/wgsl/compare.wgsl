// What a picture says is lacking, a layer over the client's view: what it is, and how far it is to be believed, is told in
// cags_common.correction.trust.
struct Compare { size: vec2<u32>, error: f32, unused: u32 }
@group(0) @binding(0) var<uniform> job: Compare;
@group(0) @binding(1) var<storage, read> coded: array<f32>;              // the decoded picture [h][w][3] in [0, 1]
@group(0) @binding(2) var<storage, read> own: array<vec4<f32>>;          // the client's view from the reference camera
@group(0) @binding(3) var<storage, read_write> apart: array<f32>;        // of each 16 x 16 pixels, the sum of squared differences
@group(0) @binding(4) var<storage, read_write> lack: array<vec4<f32>>;   // what is laid over: premultiplied colour, opacity
const AROUND = 3;
const SIDE = 22u;            // pixels of a workgroup and of what is around them
const NEAR = 147.0;          // values of a neighbourhood: 7 x 7 pixels, three channels
const NOISE_WEIGHT = 2.0;
const LEAST_POWER = 1e-9;
const LEAST_DETAIL = 1e-4;

fn own_at(i: u32) -> vec3<f32> { return clamp(own[i].xyz, vec3(0.0), vec3(1.0)); }
fn coded_at(i: u32) -> vec3<f32> { return clamp(vec3(coded[3u * i], coded[3u * i + 1u], coded[3u * i + 2u]), vec3(0.0), vec3(1.0)); }

// Beyond the edge the pixels on its other side, the outermost not twice. `at` is AROUND before the first at least. Unsigned,
// because Vulkan leaves the remainder of negative numbers undefined.
fn mirrored(at: i32, size: u32) -> u32 {
  let most = size - 1u;
  if (most == 0u) { return 0u; }
  let turn = u32(at + 4 * i32(most)) % (2u * most);
  return select(turn, 2u * most - turn, turn > most);
}

var<workgroup> sums: array<f32, 256>;

fn summed(lane: u32, value: f32) -> f32 {
  sums[lane] = value;
  workgroupBarrier();
  for (var half = 128u; half > 0u; half /= 2u) {
    if (lane < half) { sums[lane] += sums[lane + half]; }
    workgroupBarrier();
  }
  return sums[0];
}

// How far the two are apart in each workgroup's pixels.
@compute @workgroup_size(16, 16) fn measure(
  @builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) group: vec3<u32>,
  @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32
) {
  var power = 0.0;
  if (all(id.xy < job.size)) {
    let i = id.y * job.size.x + id.x;
    let d = own_at(i) - coded_at(i);
    power = dot(d, d);
  }
  let sum = summed(lane, power);
  if (lane == 0u) { apart[group.y * groups.x + group.x] = sum; }
}

var<workgroup> ours: array<f32, 1452>;    // three for each of SIDE x SIDE pixels
var<workgroup> theirs: array<f32, 1452>;

@compute @workgroup_size(16, 16) fn compare(
  @builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>,
  @builtin(local_invocation_id) local: vec3<u32>, @builtin(local_invocation_index) lane: u32
) {
  for (var k = lane; k < SIDE * SIDE; k += 256u) {
    let at = vec2<i32>(group.xy * 16u + vec2(k % SIDE, k / SIDE)) - AROUND;
    let i = mirrored(at.y, job.size.y) * job.size.x + mirrored(at.x, job.size.x);
    let a = own_at(i); let b = coded_at(i);
    for (var c = 0u; c < 3u; c++) { ours[3u * k + c] = a[c]; theirs[3u * k + c] = b[c]; }
  }
  var part = 0.0;
  for (var k = lane; k < groups.x * groups.y; k += 256u) { part += apart[k]; }
  let over_picture = summed(lane, part) / f32(3u * job.size.x * job.size.y);  // and what was stored above is there
  if (any(id.xy >= job.size)) { return; }
  var own_mean = vec3(0.0); var coded_mean = vec3(0.0); var own_power = 0.0; var together = 0.0; var away = 0.0;
  for (var y = 0u; y < 7u; y++) {
    for (var x = 0u; x < 7u; x++) {
      let k = 3u * ((local.y + y) * SIDE + local.x + x);
      let a = vec3(ours[k], ours[k + 1u], ours[k + 2u]); let b = vec3(theirs[k], theirs[k + 1u], theirs[k + 2u]);
      own_mean += a; coded_mean += b;
      own_power += dot(a, a); together += dot(a, b); away += dot(a - b, a - b);
    }
  }
  own_mean /= 49.0; coded_mean /= 49.0;
  let over_own = max(over_picture - job.error, LEAST_POWER);
  let noise = NOISE_WEIGHT * max(1.0, job.error / over_own) * job.error;
  let share = clamp(1.0 - noise / max(away / NEAR, LEAST_POWER), 0.0, 1.0);
  let spread = own_power / NEAR - dot(own_mean, own_mean) / 3.0;
  let common_detail = together / NEAR - dot(own_mean, coded_mean) / 3.0;
  let least = max(job.error, LEAST_DETAIL);
  let kept = clamp((common_detail + least) / max(spread + least, LEAST_POWER), 0.0, 1.0);
  let i = id.y * job.size.x + id.x;
  lack[i] = vec4(share * (coded_at(i) - kept * own_at(i)), share * (1.0 - kept));
}
