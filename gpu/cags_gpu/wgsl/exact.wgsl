// Camera coordinates as the definition has them, by 48-bit integers rounded once. The order of splats and their culling hang
// on the depth's last bit, and what is drawn at an ellipse's rim on the centre's; float32 loses both by cancellation, and
// tricks with pairs of floats do not survive a compiler that may reassociate.
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

fn signed(v: Wide, negative: bool) -> Wide {
  if (negative) { return negated(v); }
  return v;
}

fn is_negative(v: Wide) -> bool { return (v.high >> 31u) != 0u; }

fn leading_zeros(v: Wide) -> i32 {
  if (v.high != 0u) { return i32(countLeadingZeros(v.high)); }
  return 32 + i32(countLeadingZeros(v.low));
}

fn size_zeros(v: Wide) -> i32 { return leading_zeros(signed(v, is_negative(v))); }

fn float_of(v: Wide) -> f32 {
  let size = signed(v, is_negative(v));
  let value = f32(size.high) * 4294967296.0 + f32(size.low);
  return select(value, -value, is_negative(v));
}

fn mantissa_of(bits: u32) -> Wide {
  return Wide(0u, select(0u, (bits & 0x7fffffu) | 0x800000u, (bits & 0x7f800000u) != 0u));
}

fn exponent_of(bits: u32) -> i32 { return select(i32((bits >> 23u) & 255u) - 127, -2000, (bits & 0x7f800000u) == 0u); }

// A component of mean - position in units of 2^(top - 47).
fn offset_of(bits: u32, origin: vec4<u32>, top: i32) -> Wide {
  let mean = signed(shifted(mantissa_of(bits), 24 + exponent_of(bits) - top), (bits >> 31u) != 0u);
  let here = shifted(Wide(origin.x, origin.y), i32(origin.z) - 2048 - top - 5);
  return plus(mean, signed(here, origin.w == 0u));
}

// (value 2^by) x limbs / 2^32; the shifted value below 2^46 in size, the limbs at most 2^47.
fn product_of(value: Wide, by: i32, limbs: vec4<u32>) -> Wide {
  let negative = is_negative(value);
  let a = shifted(signed(value, negative), by);
  let a2 = a.high; let a1 = a.low >> 16u; let a0 = a.low & 0xffffu;
  var sum = Wide(a2 * limbs.x, 0u);
  sum = plus(sum, shifted(Wide(0u, a2 * limbs.y), 16));
  sum = plus(sum, shifted(Wide(0u, a1 * limbs.x), 16));
  sum = plus(sum, Wide(0u, a2 * limbs.z));
  sum = plus(sum, Wide(0u, a1 * limbs.y));
  sum = plus(sum, Wide(0u, a0 * limbs.x));
  return signed(sum, negative != (limbs.w != 0u));
}

// A point in the camera's frame: x, y, z in units of 2^exponent.
struct Exact { x: Wide, y: Wide, z: Wide, exponent: i32, unit: f32 }

fn exact_point(mean: vec3<u32>) -> Exact {
  let from_top = max(max(i32(view.from_x.z), i32(view.from_y.z)), i32(view.from_z.z)) - 2048;
  let top = max(max(exponent_of(mean.x), exponent_of(mean.y)), max(exponent_of(mean.z), from_top));
  let x = offset_of(mean.x, view.from_x, top);
  let y = offset_of(mean.y, view.from_y, top);
  let z = offset_of(mean.z, view.from_z, top);
  let by = min(min(size_zeros(x), size_zeros(y)), size_zeros(z)) - 18;  // the largest component gets 46 bits
  let exponent = top - by - 62;  // 2^(top - 47) a unit, less the shift, the limbs' 2^47, and 2^32 back
  return Exact(
    plus(plus(product_of(x, by, view.row_x_x), product_of(y, by, view.row_x_y)), product_of(z, by, view.row_x_z)),
    plus(plus(product_of(x, by, view.row_y_x), product_of(y, by, view.row_y_y)), product_of(z, by, view.row_y_z)),
    plus(plus(product_of(x, by, view.row_z_x), product_of(y, by, view.row_z_y)), product_of(z, by, view.row_z_z)),
    exponent, exp2(f32(exponent)));
}

// z as a float, rounded to nearest, ties to even; 0 where it is not positive.
fn depth_of(p: Exact) -> f32 {
  let zeros = leading_zeros(p.z);
  if (zeros == 0 || zeros == 64) { return 0.0; }  // negative, or nothing
  let aligned = shifted(p.z, zeros);
  let kept = aligned.high >> 8u;
  let rest = aligned.high & 0xffu;
  let up = rest > 128u || (rest == 128u && (aligned.low != 0u || (kept & 1u) == 1u));
  let exponent = p.exponent + 63 - zeros;
  if (exponent < -126 || exponent > 126) { return select(0.0, 3e38, exponent > 126); }
  return bitcast<f32>((u32(exponent + 127) << 23u) + (kept & 0x7fffffu) + select(0u, 1u, up));
}

// What `rounded` lacks of the exact coordinate, pixels: (f x + (c - rounded) z) / z. 0 where the numbers are too large.
fn rest_of(x: Wide, z: Wide, focal: vec4<u32>, principal: vec2<u32>, rounded: f32) -> f32 {
  let bits = bitcast<u32>(rounded);
  let place = signed(shifted(mantissa_of(bits), exponent_of(bits) + 8), (bits >> 31u) != 0u);  // x 2^31
  let away = plus(Wide(principal.x, principal.y), negated(place));
  let far = signed(away, is_negative(away));
  if (focal.w != 0u || far.high >= 0x8000u) { return 0.0; }
  let limbs = vec4(far.high, far.low >> 16u, far.low & 0xffffu, u32(is_negative(away)));
  let by = min(size_zeros(x), size_zeros(z)) - 18;
  let sum = plus(product_of(x, by, focal), product_of(z, by, limbs));
  return float_of(sum) / float_of(z) * exp2(f32(1 - by));
}

fn centre_rest(p: Exact, rounded: vec2<f32>) -> vec2<f32> {
  return vec2(rest_of(p.x, p.z, view.focal_x, view.principal_xy.xy, rounded.x),
              rest_of(p.y, p.z, view.focal_y, view.principal_xy.zw, rounded.y));
}
