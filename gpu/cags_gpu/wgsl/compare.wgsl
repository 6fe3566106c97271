// What a picture says is lacking: it less the client's render from its camera, as far as the two differ by more than coding has
// left in the picture (cags_common.correction.trust: Wiener's share over neighbourhoods of 7 x 7).
struct Compare { size: vec2<u32>, error: f32, unused: u32 }
@group(0) @binding(0) var<uniform> job: Compare;
@group(0) @binding(1) var<storage, read> coded: array<f32>;              // the decoded picture [h][w][3] in [0, 1]
@group(0) @binding(2) var<storage, read> own: array<vec4<f32>>;          // the client's view from the reference camera
@group(0) @binding(3) var<storage, read_write> lack: array<vec4<f32>>;   // what is added, at the reference's pixels
const AROUND = 3;
const SIDE = 22u;            // pixels of a workgroup and of what is around them
const NOISE_WEIGHT = 2.0;
const LEAST_POWER = 1e-9;

fn own_at(i: u32) -> vec3<f32> { return clamp(own[i].xyz, vec3(0.0), vec3(1.0)); }
fn away(i: u32) -> vec3<f32> { return vec3(coded[3u * i], coded[3u * i + 1u], coded[3u * i + 2u]) - own_at(i); }

// Beyond the edge the pixels on its other side, the outermost not twice.
fn mirrored(at: i32, size: u32) -> u32 {
  let most = i32(size) - 1;
  if (most == 0) { return 0u; }
  let turn = ((at % (2 * most)) + 2 * most) % (2 * most);
  return u32(select(turn, 2 * most - turn, turn > most));
}

var<workgroup> power: array<f32, 484>;

@compute @workgroup_size(16, 16) fn compare(
  @builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) group: vec3<u32>,
  @builtin(local_invocation_id) local: vec3<u32>, @builtin(local_invocation_index) lane: u32
) {
  for (var k = lane; k < SIDE * SIDE; k += 256u) {
    let at = vec2<i32>(group.xy * 16u + vec2(k % SIDE, k / SIDE)) - AROUND;
    let d = away(mirrored(at.y, job.size.y) * job.size.x + mirrored(at.x, job.size.x));
    power[k] = dot(d, d);
  }
  workgroupBarrier();
  if (any(id.xy >= job.size)) { return; }
  var sum = 0.0;
  for (var y = 0u; y < 7u; y++) {
    for (var x = 0u; x < 7u; x++) { sum += power[(local.y + y) * SIDE + local.x + x]; }
  }
  let share = clamp(1.0 - NOISE_WEIGHT * job.error / max(sum / 147.0, LEAST_POWER), 0.0, 1.0);
  let i = id.y * job.size.x + id.x;
  lack[i] = vec4(clamp(own_at(i) + share * away(i), vec3(0.0), vec3(1.0)) - own_at(i), 0.0);
}
