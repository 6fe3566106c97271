// A frame that was worked out at half the pixels a side, brought up by cubic convolution (Keys 1981, a = -3/4).
struct Enlarge { size: vec2<u32>, half: vec2<u32> }
@group(0) @binding(0) var<uniform> job: Enlarge;
@group(0) @binding(1) var<storage, read> small: array<vec4<f32>>;        // colours in [0, 1], confidence
@group(0) @binding(2) var<storage, read_write> shown: array<u32>;        // 8 bits a channel; the confidence of the pixel that it lies in
const NEAR = vec4(-0.03515625, 0.26171875, 0.87890625, -0.10546875);     // of four pixels, for a centre 3/4 past the second

fn row(y: i32, first: i32, weights: vec4<f32>) -> vec3<f32> {
  let at = u32(clamp(y, 0, i32(job.half.y) - 1)) * job.half.x;
  var sum = vec3(0.0);
  for (var k = 0; k < 4; k++) { sum += weights[k] * small[at + u32(clamp(first + k, 0, i32(job.half.x) - 1))].xyz; }
  return sum;
}

@compute @workgroup_size(16, 16) fn enlarge(@builtin(global_invocation_id) id: vec3<u32>) {
  if (any(id.xy >= job.size)) { return; }
  let odd = id.xy % 2u == vec2(1u);
  let first = vec2<i32>(id.xy / 2u) - select(vec2(2), vec2(1), odd);
  let across = select(NEAR, NEAR.wzyx, odd.x);
  let down = select(NEAR, NEAR.wzyx, odd.y);
  var sum = vec3(0.0);
  for (var k = 0; k < 4; k++) { sum += down[k] * row(first.y + k, first.x, across); }
  let confidence = small[(id.y / 2u) * job.half.x + id.x / 2u].w;
  shown[id.y * job.size.x + id.x] = pack4x8unorm(vec4(clamp(sum, vec3(0.0), vec3(1.0)), confidence));
}
