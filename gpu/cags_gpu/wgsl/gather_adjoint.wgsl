// The sums of each splat's entries: weighted residual (of a picture in [-1, 1]) and weight, in pixels.
@group(0) @binding(0) var<storage, read> state: array<u32>;
@group(0) @binding(1) var<storage, read> slot_splat: array<u32>;
@group(0) @binding(2) var<storage, read> slots: array<vec4<i32>>;
@group(0) @binding(3) var<storage, read_write> carried: array<vec4<f32>>;  // cleared by the host

@compute @workgroup_size(256)
fn gather(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = state[1];
  for (var i = id.x; i < n; i += groups.x * 256u) {
    let splat = slot_splat[i];
    if (i > 0u && slot_splat[i - 1u] == splat) { continue; }
    var sum = vec4(0.0);
    for (var k = i; k < n && slot_splat[k] == splat; k++) { sum += vec4<f32>(slots[k]) / 4194304.0; }
    carried[splat] = sum;
  }
}
