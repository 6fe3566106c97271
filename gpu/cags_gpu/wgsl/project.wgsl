// Stage 1: to the camera, culled, projected; EWA splatting as in Kerbl et al. 2023, with the footprint's compensation.
// One thread a splat of a chunk: harmonics may be split over several buffers, each within a binding's limit.
struct Chunk { first: u32, count: u32, unused_a: u32, unused_b: u32 }
@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> chunk: Chunk;
@group(0) @binding(2) var<storage, read> motion: array<vec4<f32>>;  // 2 a splat: mean and logit, quaternion
@group(0) @binding(3) var<storage, read> looks: array<vec4<f32>>;   // 2 a splat: log scale, base colour
@group(0) @binding(4) var<storage, read> sh_rest: array<f32>;       // [chunk.count][sh_count][3]
@group(0) @binding(5) var<storage, read> ranks: array<u32>;         // of all layers' splats in the order of content hashes
@group(0) @binding(6) var<storage, read_write> records: array<vec4<u32>>;
@group(0) @binding(7) var<storage, read_write> colours: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> keys: array<u32>;     // by rank: depth's bits, ABSENT where not drawn
@group(0) @binding(9) var<storage, read_write> touched: array<u32>;  // tiles

// See cags_common.raster.definition.
const LARGEST_LOG_SCALE = 16.118095651;  // log(1e7)
const FARTHEST = 1e12;                   // of a splat that is drawn, world units
const OUTERMOST = 1e9;                   // of a centre, pixels: single precision ends there
const LEAST_KEPT = 1e-30;                // share of a splat's opacity that its dilation leaves
const BRIGHTEST = 3e38;                  // of a splat; pictures end at view.brightest
const LARGEST_HALF = 65504.0;            // of a 16-bit float
const REST_UNIT = 65536.0;               // of what a rounded centre lacks, 2^-16 pixels

fn harmonic(k: u32, d: vec3<f32>) -> f32 {
  let x = d.x; let y = d.y; let z = d.z; let xx = x * x; let yy = y * y; let zz = z * z;
  switch k {
    case 0u: { return -0.4886025119029199 * y; }
    case 1u: { return 0.4886025119029199 * z; }
    case 2u: { return -0.4886025119029199 * x; }
    case 3u: { return 1.0925484305920792 * x * y; }
    case 4u: { return -1.0925484305920792 * y * z; }
    case 5u: { return 0.31539156525252005 * (2.0 * zz - xx - yy); }
    case 6u: { return -1.0925484305920792 * x * z; }
    case 7u: { return 0.5462742152960396 * (xx - yy); }
    case 8u: { return -0.5900435899266435 * y * (3.0 * xx - yy); }
    case 9u: { return 2.890611442640554 * x * y * z; }
    case 10u: { return -0.4570457994644658 * y * (4.0 * zz - xx - yy); }
    case 11u: { return 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy); }
    case 12u: { return -0.4570457994644658 * x * (4.0 * zz - xx - yy); }
    case 13u: { return 1.445305721320277 * z * (xx - yy); }
    default: { return -0.5900435899266435 * x * (xx - 3.0 * yy); }
  }
}

fn colour(i: u32, base: vec3<f32>, toward: vec3<f32>) -> vec3<f32> {
  var rgb = 0.5 + 0.28209479177387814 * base;
  if (view.sh_used > 0u) {
    let d = toward / max(length(toward), 1e-15);
    for (var k = 0u; k < view.sh_used; k++) {
      let at = ((i - chunk.first) * view.sh_count + k) * 3u;
      rgb += harmonic(k, d) * vec3(sh_rest[at], sh_rest[at + 1u], sh_rest[at + 2u]);
    }
  }
  return clamp(rgb, vec3(0.0), vec3(BRIGHTEST));
}

fn touched_tiles(d: Drawn) -> u32 {
  let rows = tile_rows(d, view.size);
  var sum = 0u;
  for (var row = rows.x; row <= rows.y; row++) {
    let columns = tile_columns(d, row, view.size);
    sum += u32(max(columns.y - columns.x + 1, 0));
  }
  return sum;
}

@compute @workgroup_size(256) fn project(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x >= chunk.count) { return; }
  let i = chunk.first + id.x;
  let to = view.base + i; let rank = ranks[to];
  keys[rank] = ABSENT;
  touched[to] = 0u;
  let placed = motion[2u * i]; let q = normalize(motion[2u * i + 1u]);
  let scale = exp(min(looks[2u * i].xyz, vec3(LARGEST_LOG_SCALE)));
  let toward = (placed.xyz - view.position.xyz) - view.position_rest.xyz;
  let exact = exact_point(bitcast<vec3<u32>>(placed.xyz));
  let p = vec3(float_of(exact.x) * exact.unit, float_of(exact.y) * exact.unit, depth_of(exact));
  if (!(p.z > view.near && p.z < FARTHEST)) { return; }
  let inverse = 1.0 / p.z;
  let slope = clamp(p.xy * inverse, -view.limit, view.limit);
  let w = q.x; let x = q.y; let y = q.z; let z = q.w;
  let m0 = scale.x * vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y));  // scaled axes
  let m1 = scale.y * vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x));
  let m2 = scale.z * vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
  let jx = view.focal.x * inverse * (view.row_x.xyz - slope.x * view.row_z.xyz);
  let jy = view.focal.y * inverse * (view.row_y.xyz - slope.y * view.row_z.xyz);
  let a = vec3(dot(jx, m0), dot(jx, m1), dot(jx, m2));
  let b = vec3(dot(jy, m0), dot(jy, m1), dot(jy, m2));
  let xx = dot(a, a); let xy = dot(a, b); let yy = dot(b, b);
  let inverse_yy = 1.0 / (yy + view.variance);
  let minors = cross(a, b) * sqrt(inverse_yy);  // det by the factor's minors: no cancellation on needles
  let minors_over_yy = dot(minors, minors);
  let conditional = minors_over_yy + view.variance * ((xx + yy + view.variance) * inverse_yy);
  var strength = -log2(1.0 + exp(-placed.w));
  if (view.variance != view.dilation) {
    let kept = (minors_over_yy + view.dilation * ((xx + yy + view.dilation) * inverse_yy)) / conditional;
    strength += 0.5 * log2(clamp(kept, LEAST_KEPT, 1.0));
  }
  if (!(strength > LOG2_ALPHA_CUT && conditional > 0.0)) { return; }
  let unit = sqrt(HALF_LOG2E);
  let l11 = unit / sqrt(conditional);
  let centre = p.xy * inverse * view.focal + view.principal;
  if (!(all(abs(centre) < vec2(OUTERMOST)))) { return; }
  let first = vec4(centre, l11, -xy * inverse_yy * l11);
  let l22 = unit * sqrt(inverse_yy);
  let rgb = colour(i, looks[2u * i + 1u].xyz, toward);
  var second = vec4(bitcast<u32>(l22), bitcast<u32>(p.z), bitcast<u32>(strength), 0u);
  if (PACKED) {
    let bright = min(rgb, vec3(LARGEST_HALF));
    let opacity = u32(round(clamp(1.0 - strength / LEAST_LOG2, 0.0, 1.0) * 65535.0));
    second.z = pack2x16float(bright.xy);
    second.w = (pack2x16float(vec2(bright.z, 0.0)) & 0xffffu) | (opacity << 16u);
  } else {
    colours[to] = vec4(rgb, 0.0);
    second.w = pack2x16float(clamp(centre_rest(exact, centre) * REST_UNIT, vec2(-LARGEST_HALF), vec2(LARGEST_HALF)));
  }
  let drawn = drawn_of(bitcast<vec4<u32>>(first), second);  // as it is stored: binning sees the same ellipse
  let tiles = touched_tiles(drawn);
  if (tiles == 0u) { return; }
  records[2u * to] = bitcast<vec4<u32>>(first);
  records[2u * to + 1u] = second;
  touched[to] = tiles;
  keys[rank] = bitcast<u32>(p.z);
}
