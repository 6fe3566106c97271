// The order of content hashes, which settles equal depths: the splats' indices before the sort, their ranks after it.
struct Count { count: u32, base: u32, unused_a: u32, unused_b: u32 }  // base: splats of the layers before
@group(0) @binding(0) var<uniform> job: Count;
@group(0) @binding(1) var<storage, read> indices: array<u32>;
@group(0) @binding(2) var<storage, read_write> to: array<u32>;
@group(0) @binding(3) var<storage, read_write> kept: array<u32>;

fn flat(id: vec3<u32>, groups: vec3<u32>) -> u32 { return id.y * groups.x * 256u + id.x; }

@compute @workgroup_size(256) fn identity(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = flat(id, groups);
  if (i < job.count) { to[i] = i; }
}

@compute @workgroup_size(256) fn invert(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = flat(id, groups);
  if (i >= job.count) { return; }
  to[indices[i]] = i;
  kept[i] = indices[i];  // the sort's own buffers are used again in every frame
}

// The order of a layer that is in order by itself, after those of the layers before; and the ranks.
@compute @workgroup_size(256) fn layer(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = flat(id, groups);
  if (i >= job.count) { return; }
  let splat = job.base + indices[i];
  to[job.base + i] = splat;
  kept[splat] = job.base + i;
}

// A layer that is to be sorted together with the others: its splats, and their hashes.
@compute @workgroup_size(256) fn gathered(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
  let i = flat(id, groups);
  if (i >= job.count) { return; }
  to[job.base + i] = job.base + i;
  kept[job.base + i] = indices[i];
}
