// Where each tile's entries begin and end; tiles without any keep zeros (the host clears them).
@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> state: array<u32>;
@group(0) @binding(2) var<storage, read> entry_tile: array<u32>;
@group(0) @binding(3) var<storage, read_write> ranges: array<vec2<u32>>;

@compute @workgroup_size(256)
fn ranges_of(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let n = state[1];
  let tiles = view.layers * view.tiles.x * view.tiles.y;
  for (var i = id.x; i < n; i += groups.x * 256u) {
    let tile = entry_tile[i];
    if (tile >= tiles) { continue; }
    if (i == 0u || entry_tile[i - 1u] != tile) { ranges[tile].x = i; }
    if (i == n - 1u || entry_tile[i + 1u] != tile) { ranges[tile].y = i + 1u; }
  }
}
