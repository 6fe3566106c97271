// The server's side: truth less the client's copy, both from the reference camera, brought into [0, 1] by an odd compander.
struct Compand { size: vec2<u32>, knee: f32, unused: u32 }
@group(0) @binding(0) var<uniform> job: Compand;
@group(0) @binding(1) var<storage, read> truth: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> mirror: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> coded: array<f32>;  // [h][w][3]; 0.5 where nothing is lacking

@compute @workgroup_size(16, 16) fn compand(@builtin(global_invocation_id) id: vec3<u32>) {
  if (any(id.xy >= job.size)) { return; }
  let i = id.y * job.size.x + id.x;
  let lack = clamp(truth[i].xyz, vec3(0.0), vec3(1.0)) - clamp(mirror[i].xyz, vec3(0.0), vec3(1.0));
  let p = clamp(asinh(lack / job.knee) / asinh(1.0 / job.knee) * 0.5 + 0.5, vec3(0.0), vec3(1.0));
  for (var c = 0u; c < 3u; c++) { coded[3u * i + c] = p[c]; }
}
