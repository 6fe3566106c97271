// Stage 1: to the camera, culled, projected; EWA splatting as in Kerbl et al. 2023, with the footprint's compensation.
// One thread a splat of a chunk: harmonics may be split over several buffers, each within a binding's limit.
struct Chunk { first: u32, count: u32, kind: u32, unused: u32 }
@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> chunk: Chunk;
@group(0) @binding(2) var<storage, read> motion: array<vec4<f32>>;  // 2 a splat: mean, quaternion
@group(0) @binding(3) var<storage, read> looks: array<vec4<f32>>;   // 2 a splat: log scale and logit, base colour
@group(0) @binding(4) var<storage, read> sh_rest: array<f32>;       // [chunk.count][sh_count][3]
@group(0) @binding(5) var<storage, read> ranks: array<u32>;         // of each splat in the order of content hashes
@group(0) @binding(6) var<storage, read_write> records: array<vec4<u32>>;
@group(0) @binding(7) var<storage, read_write> colours: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> keys: array<u32>;     // by rank: depth's bits, ABSENT where not drawn
@group(0) @binding(9) var<storage, read_write> touched: array<u32>;  // tiles

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
  return clamp(rgb, vec3(0.0), vec3(3e38));  // not to `brightest`: pictures end there, splats do not
}

// Camera z as the definition has it: by 48-bit integers, rounded once. Order and culling hang on its last bit, float32
// loses it by cancellation, and tricks with pairs of floats do not survive a compiler that may reassociate.
struct Wide { high: u32, low: u32 }  // 64 bits, two's complement

fn shifted(v: Wide, by: i32) -> Wide {  // to the left; negative: to the right, cut off
  if (by >= 64 || by <= -64) { return Wide(0u, 0u); }
  let n = u32(abs(by));
  if (by == 0) { return v; }
  if (by > 0) {
    if (n >= 32u) { return Wide(v.low << (n - 32u), 0u); }
    return Wide((v.high << n) | (v.low >> (32u - n)), v.low << n);
  }
  if (n >= 32u) { return Wide(0u, v.high >> (n - 32u)); }
  return Wide(v.high >> n, (v.low >> n) | (v.high << (32u - n)));
}

fn plus(a: Wide, b: Wide) -> Wide {
  let low = a.low + b.low;
  return Wide(a.high + b.high + select(0u, 1u, low < a.low), low);
}

fn negated(v: Wide) -> Wide { return plus(Wide(~v.high, ~v.low), Wide(0u, 1u)); }
fn signed(v: Wide, negative: bool) -> Wide { if (negative) { return negated(v); } return v; }
fn leading_zeros(v: Wide) -> i32 { if (v.high != 0u) { return i32(countLeadingZeros(v.high)); } return 32 + i32(countLeadingZeros(v.low)); }

fn exponent_of(bits: u32) -> i32 { return select(i32((bits >> 23u) & 255u) - 127, -2000, (bits & 0x7fffffffu) == 0u); }

// A component of mean - position in units of 2^(top - 47).
fn offset_of(bits: u32, from_part: vec4<u32>, top: i32) -> Wide {
  let mantissa = select(0u, (bits & 0x7fffffu) | 0x800000u, (bits & 0x7f800000u) != 0u);
  let mean = signed(shifted(Wide(0u, mantissa), 24 + exponent_of(bits) - top), (bits >> 31u) != 0u);
  let here = shifted(Wide(from_part.x, from_part.y), i32(from_part.z) - 2048 - top - 5);
  return plus(mean, signed(here, from_part.w == 0u));
}

// |offset| x |row| / 2^32 with the product's sign; the offset below 2^46, the row at most 2^47.
fn product_of(offset: Wide, by: i32, row: vec4<u32>) -> Wide {
  let negative = (offset.high >> 31u) != 0u;
  let a = shifted(signed(offset, negative), by);
  let a2 = a.high; let a1 = a.low >> 16u; let a0 = a.low & 0xffffu;
  var sum = Wide(a2 * row.x, 0u);
  sum = plus(sum, shifted(Wide(0u, a2 * row.y), 16));
  sum = plus(sum, shifted(Wide(0u, a1 * row.x), 16));
  sum = plus(sum, Wide(0u, a2 * row.z));
  sum = plus(sum, Wide(0u, a1 * row.y));
  sum = plus(sum, Wide(0u, a0 * row.x));
  return signed(sum, negative != (row.w != 0u));
}

// z as a float, rounded to nearest, ties to even; 0 where it is not positive.
fn depth_of(mean: vec3<u32>) -> f32 {
  let from_top = max(max(i32(view.from_x.z), i32(view.from_y.z)), i32(view.from_z.z)) - 2048;
  let top = max(max(exponent_of(mean.x), exponent_of(mean.y)), max(exponent_of(mean.z), from_top));
  let x = offset_of(mean.x, view.from_x, top);
  let y = offset_of(mean.y, view.from_y, top);
  let z = offset_of(mean.z, view.from_z, top);
  let largest = min(min(magnitude_zeros(x), magnitude_zeros(y)), magnitude_zeros(z));
  let by = largest - 18;  // the largest component gets 46 bits
  var sum = product_of(x, by, view.depth_x);
  sum = plus(sum, product_of(y, by, view.depth_y));
  sum = plus(sum, product_of(z, by, view.depth_z));
  let zeros = leading_zeros(sum);
  if (zeros == 0 || zeros == 64) { return 0.0; }  // negative, or nothing
  let aligned = shifted(sum, zeros);  // bit 63 is the leading one
  let kept = aligned.high >> 8u;
  let rest = (aligned.high & 0xffu);
  let up = rest > 128u || (rest == 128u && (aligned.low != 0u || (kept & 1u) == 1u));
  // the sum is in units of 2^(top - 47 - by - 47 + 32); its leading one is bit 63 - zeros
  let exponent = top - 62 - by + 63 - zeros;
  if (exponent < -126 || exponent > 126) { return select(0.0, 3e38, exponent > 126); }
  return bitcast<f32>((u32(exponent + 127) << 23u) + (kept & 0x7fffffu) + select(0u, 1u, up));
}

fn magnitude_zeros(v: Wide) -> i32 { return leading_zeros(signed(v, (v.high >> 31u) != 0u)); }

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
  keys[ranks[i]] = ABSENT;
  touched[i] = 0u;
  let mean = motion[2u * i].xyz; let q = normalize(motion[2u * i + 1u]);
  let look = looks[2u * i];
  let scale = exp(min(look.xyz, vec3(16.118095651)));
  let toward = (mean - view.position.xyz) - view.position_rest.xyz;
  let p = vec3(dot(view.row_x.xyz, toward), dot(view.row_y.xyz, toward), depth_of(bitcast<vec3<u32>>(mean)));
  if (!(p.z > view.near && p.z < 1e12)) { return; }
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
  var strength = -log2(1.0 + exp(-look.w));
  if (view.variance != view.dilation) {
    let kept = (minors_over_yy + view.dilation * ((xx + yy + view.dilation) * inverse_yy)) / conditional;
    strength += 0.5 * log2(clamp(kept, 1e-30, 1.0));
  }
  if (!(strength > LOG2_ALPHA_CUT && conditional > 0.0)) { return; }
  let unit = sqrt(HALF_LOG2E);
  let l11 = unit / sqrt(conditional);
  let centre = p.xy * inverse * view.focal + view.principal;
  let first = vec4(centre, l11, -xy * inverse_yy * l11);
  let l22 = unit * sqrt(inverse_yy);
  let rgb = colour(i, looks[2u * i + 1u].xyz, toward);
  var second = vec4(bitcast<u32>(l22), bitcast<u32>(p.z), bitcast<u32>(strength), 0u);
  if (PACKED) {
    let bright = min(rgb, vec3(65504.0));
    let opacity = u32(round(clamp(1.0 - strength / LEAST_LOG2, 0.0, 1.0) * 65535.0));
    second.z = pack2x16float(bright.xy);
    second.w = (pack2x16float(vec2(bright.z, 0.0)) & 0xffffu) | (opacity << 16u);
  } else {
    colours[i] = vec4(rgb, 0.0);
  }
  let drawn = drawn_of(bitcast<vec4<u32>>(first), second);  // as it is stored: binning sees the same ellipse
  if (!(abs(centre.x) < 1e9 && abs(centre.y) < 1e9)) { return; }
  let tiles = touched_tiles(drawn);
  if (tiles == 0u) { return; }
  records[2u * i] = bitcast<vec4<u32>>(first);
  records[2u * i + 1u] = second;
  touched[i] = tiles;
  keys[ranks[i]] = bitcast<u32>(p.z);
}
