// The server's side: truth less the client's copy, both from the reference camera, brought into [0, 1] by a
// compander (cags_common.correction.compander).
struct Compand { size: vec2<u32>, knee: f32, unused: u32 }
@group(0) @binding(0) var<uniform> job: Compand;
@group(0) @binding(1) var<storage, read> truth: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> mirror: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> coded: array<f32>;  // [h][w][3]; ZERO where nothing is lacking
const ZERO = 110.0 / 219.0; const SPAN = 109.0 / 219.0;

@compute @workgroup_size(16, 16) fn compand(@builtin(global_invocation_id) id: vec3<u32>) {
  if (any(id.xy >= job.size)) { return; }
  let i = id.y * job.size.x + id.x;
  let lack = clamp(truth[i].xyz, vec3(0.0), vec3(1.0)) - clamp(mirror[i].xyz, vec3(0.0), vec3(1.0));
  let p = ZERO + SPAN * (asinh(lack / job.knee) / asinh(1.0 / job.knee));
  for (var c = 0u; c < 3u; c++) { coded[3u * i + c] = p[c]; }
}
