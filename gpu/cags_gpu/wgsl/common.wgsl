// Shared by the rasteriser's stages. Hosts put this file before each stage's: WGSL has no includes.
// Several views of one size may be drawn together, as layers: the splats of each, and its tiles, follow those of the one
// before. Camera and harmonics are each layer's own; what all stages after `project` read is the same in all of them.
struct View {
  row_x: vec4<f32>, row_y: vec4<f32>, row_z: vec4<f32>,  // world to camera
  position: vec4<f32>, position_rest: vec4<f32>,         // the camera's position as a sum of two floats
  focal: vec2<f32>, principal: vec2<f32>,
  limit: vec2<f32>, size: vec2<u32>,
  tiles: vec2<u32>, near: f32, dilation: f32,
  variance: f32, void_alpha: f32, stop: f32, brightest: f32,
  count: u32, sh_count: u32, sh_used: u32, capacity: u32,                 // splats of all layers
  splats: u32, base: u32, layers: u32, unused: u32,                       // of a layer; those of the layers before; how many
  // for exact centres and depths: limbs of 16 bits of |component| 2^47 and a sign of each row's x, y, z; the position's
  // 53-bit mantissas (high, low), exponents + 2048 and signs; limbs of focal lengths x 2^31; principal point x 2^31
  row_x_x: vec4<u32>, row_x_y: vec4<u32>, row_x_z: vec4<u32>,
  row_y_x: vec4<u32>, row_y_y: vec4<u32>, row_y_z: vec4<u32>,
  row_z_x: vec4<u32>, row_z_y: vec4<u32>, row_z_z: vec4<u32>,
  from_x: vec4<u32>, from_y: vec4<u32>, from_z: vec4<u32>,
  focal_x: vec4<u32>, focal_y: vec4<u32>, principal_xy: vec4<u32>,
}
override PACKED: bool = false;  // records of 32 bytes with 16-bit colours and opacities; else 48 bytes of floats

const TILE = 16u;
const ALPHA_MAX = 0.99;
const LOG2_ALPHA_CUT = -7.99435344;  // log2(1 / 255)
const HALF_LOG2E = 0.72134752;
const ABSENT = 0xffffffffu;
const VOID = 0x7f800000u;  // +inf, written as bits: WGSL has no infinities
const LEAST_LOG2 = -8.0;   // of an opacity that is drawn; the packed record holds [-8, 0] in 16 bits

// A splat that touches the image: alpha is exp2(strength - s^2 - t^2) with s = l11 dx + l12 dy, t = l22 dy.
struct Drawn { centre: vec2<f32>, l11: f32, l12: f32, l22: f32, strength: f32, z: f32, rest: vec2<f32> }

// Two vectors a splat: (u, v, l11, l12), (l22, z, strength, what u and v lack of the exact centre in 2^-16 pixels);
// packed: (l22, z, red and green, blue and strength).
fn drawn_of(a: vec4<u32>, b: vec4<u32>) -> Drawn {
  let f = bitcast<vec4<f32>>(a);
  var strength = bitcast<f32>(b.z);
  var rest = vec2(0.0);
  if (PACKED) {
    strength = (f32(b.w >> 16u) / 65535.0 - 1.0) * -LEAST_LOG2;
  } else {
    rest = unpack2x16float(b.w) / 65536.0;
  }
  return Drawn(f.xy, f.z, f.w, bitcast<f32>(b.x), strength, bitcast<f32>(b.y), rest);
}

// Half the axes of the box, in standard units, that holds every pixel with an alpha of 1 / 255 or more.
fn reach_of(d: Drawn) -> f32 { return (d.strength - LOG2_ALPHA_CUT) * 1.00001 + 1e-5; }

// First and last pixel, of `size`, whose centres lie within [low, high]; first > last where there is none.
fn pixels_between(low: f32, high: f32, size: u32) -> vec2<i32> {
  let n = f32(size);
  return vec2(i32(clamp(ceil(low - 0.5), 0.0, n)), i32(clamp(floor(high - 0.5), -1.0, n - 1.0)));
}

// First and last row of pixels that the ellipse touches; first > last where there is none.
fn pixel_rows(d: Drawn, size: vec2<u32>) -> vec2<i32> {
  let half = sqrt(reach_of(d)) / d.l22;
  let margin = 1e-3 + 1e-6 * (half + abs(d.centre.y));
  return pixels_between(d.centre.y - half - margin, d.centre.y + half + margin, size.y);
}

// First and last column of pixels that it touches in rows `first` to `last`: its extremes between their centres.
fn pixel_columns(d: Drawn, first: i32, last: i32, size: vec2<u32>) -> vec2<i32> {
  let reach = reach_of(d);
  let root = sqrt(reach);
  let half = root / d.l22;
  let top = clamp(f32(first) + 0.5 - d.centre.y, -half, half);
  let bottom = clamp(f32(last) + 0.5 - d.centre.y, -half, half);
  let widest = d.l12 * root / (d.l22 * sqrt(d.l12 * d.l12 + d.l22 * d.l22));  // dy of the leftmost point
  let left = clamp(widest, top, bottom);
  let right = clamp(-widest, top, bottom);
  let low = (-d.l12 * left - sqrt(max(reach - d.l22 * d.l22 * left * left, 0.0))) / d.l11;
  let high = (-d.l12 * right + sqrt(max(reach - d.l22 * d.l22 * right * right, 0.0))) / d.l11;
  let margin = 1e-3 + 4e-6 * ((abs(d.l12) * max(abs(left), abs(right)) + root) / d.l11 + abs(d.centre.x));
  return pixels_between(d.centre.x + low - margin, d.centre.x + high + margin, size.x);
}

fn tiles_over(pixels: vec2<i32>) -> vec2<i32> { return select(pixels / i32(TILE), vec2(1, 0), pixels.x > pixels.y); }

// First and last row of tiles; first > last where the splat touches none.
fn tile_rows(d: Drawn, size: vec2<u32>) -> vec2<i32> { return tiles_over(pixel_rows(d, size)); }

// First and last tile that the ellipse touches in a row of tiles.
fn tile_columns(d: Drawn, row: i32, size: vec2<u32>) -> vec2<i32> {
  let first = row * i32(TILE);
  return tiles_over(pixel_columns(d, first, min(first + i32(TILE) - 1, i32(size.y) - 1), size));
}
