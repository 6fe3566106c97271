// What each splat got from its entries, which lie one after the other in the order of slots.
@group(0) @binding(0) var<storage, read> state: array<u32>;
@group(0) @binding(1) var<storage, read> slot_splat: array<u32>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read_write> contribution: array<f32>;  // pixels; cleared by the host

const UNIT = 8388608.0;  // of a slot, as in blend.wgsl: 2^-23 pixels

@compute @workgroup_size(256)
fn gather(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = state[1];
  for (var i = id.x; i < n; i += groups.x * 256u) {
    let splat = slot_splat[i];
    if (i > 0u && slot_splat[i - 1u] == splat) { continue; }
    var sum = 0.0;
    for (var k = i; k < n && slot_splat[k] == splat; k++) { sum += f32(slots[k]) / UNIT; }
    contribution[splat] = sum;
  }
}
