// The server's side: truth less the client's copy, both from the reference camera, and the difference brought into
// [0, 1] by a compander (cags_common.correction.compander). Three floats a pixel, as the coder takes them.
struct Compand { size: vec2<u32>, knee: f32, unused: u32 }
@group(0) @binding(0) var<uniform> job: Compand;
@group(0) @binding(1) var<storage, read> truth: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> mirror: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> seen: array<f32>;   // the truth as a display shows it, in [0, 1]
@group(0) @binding(4) var<storage, read_write> lack: array<f32>;   // in [-1, 1]
@group(0) @binding(5) var<storage, read_write> coded: array<f32>;  // ZERO where nothing is lacking
const ZERO = 110.0 / 219.0; const SPAN = 109.0 / 219.0;

@compute @workgroup_size(16, 16) fn compand(@builtin(global_invocation_id) id: vec3<u32>) {
  if (any(id.xy >= job.size)) { return; }
  let i = id.y * job.size.x + id.x;
  let t = clamp(truth[i].xyz, vec3(0.0), vec3(1.0));
  let d = t - clamp(mirror[i].xyz, vec3(0.0), vec3(1.0));
  let p = ZERO + SPAN * (asinh(d / job.knee) / asinh(1.0 / job.knee));
  for (var c = 0u; c < 3u; c++) {
    seen[3u * i + c] = t[c];
    lack[3u * i + c] = d[c];
    coded[3u * i + c] = p[c];
  }
}
