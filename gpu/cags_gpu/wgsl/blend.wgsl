// Stage 5: a workgroup a tile of 16x16 pixels, front to back, with an early end. Colour, alpha, depth; `blend_counting` also
// what each splat contributes, summed as integers: the result depends on no order. A quarter of the tile, 8x8 pixels of
// neighbouring threads, looks only at the entries that touch it: two thirds of them.
@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> records: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> colours: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> entry_value: array<u32>;
@group(0) @binding(4) var<storage, read> slot_splat: array<u32>;
@group(0) @binding(5) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> picture: array<vec2<u32>>;  // rgb, alpha: two a pixel, of floats; COMPACT: one
@group(0) @binding(7) var<storage, read_write> depth: array<u32>;          // bits of a float; +inf where void
@group(0) @binding(8) var<storage, read_write> slots: array<u32>;          // contribution of each entry, 2^-23 pixels
override COMPACT: bool = false;  // pictures for a display: 16 bits a channel
const BATCH = 256u;
const WORDS = 8u;          // BATCH / 32
const QUARTER = 8u;        // pixels a side
const UNIT = 8388608.0;    // of contributions: 2^-23 pixels
var<workgroup> batch_a: array<vec4<f32>, BATCH>;  // u, v, l11, l12
var<workgroup> batch_b: array<vec4<f32>, BATCH>;  // l22, strength, z, rest of u
var<workgroup> batch_c: array<vec4<f32>, BATCH>;  // r, g, b, rest of v
var<workgroup> touching: array<atomic<u32>, 32>;  // [4][WORDS] of each quarter, bits of the batch's entries that touch it
var<workgroup> weights: array<atomic<u32>, BATCH>;
var<workgroup> open: atomic<u32>;
var<workgroup> going_on: u32;

// Rows of tiles of one layer follow those of the layer before.
fn tile_of(group: vec2<u32>) -> vec2<u32> { return vec2(group.x, group.y % view.tiles.y); }

fn first_pixel(group: vec2<u32>) -> u32 { return group.y / view.tiles.y * view.size.x * view.size.y; }

fn pixel_of(tile: vec2<u32>, lane: u32) -> vec2<u32> {
  let quarter = lane / 64u; let within = lane % 64u;
  return tile * TILE + QUARTER * vec2(quarter % 2u, quarter / 2u) + vec2(within % QUARTER, within / QUARTER);
}

// Mark the quarters of the tile that entry `lane` of the batch touches.
fn marked(lane: u32, d: Drawn, tile: vec2<u32>) {
  let corner = vec2<i32>(tile * TILE); let side = i32(QUARTER);
  let rows = pixel_rows(d, view.size);
  for (var half = 0; half < 2; half++) {
    let first = max(corner.y + half * side, rows.x); let last = min(corner.y + half * side + side - 1, rows.y);
    if (first > last) { continue; }
    let columns = pixel_columns(d, first, last, view.size);
    if (columns.x > columns.y) { continue; }
    let word = 2u * u32(half) * WORDS + lane / 32u; let bit = 1u << (lane % 32u);
    if (columns.x < corner.x + side && columns.y >= corner.x) { atomicOr(&touching[word], bit); }
    if (columns.x < corner.x + 2 * side && columns.y >= corner.x + side) { atomicOr(&touching[word + WORDS], bit); }
  }
}

fn fetched(lane: u32, splat: u32, tile: vec2<u32>) {
  let second = records[2u * splat + 1u];
  let drawn = drawn_of(records[2u * splat], second);
  batch_a[lane] = vec4(drawn.centre, drawn.l11, drawn.l12);
  batch_b[lane] = vec4(drawn.l22, drawn.strength, drawn.z, drawn.rest.x);
  if (PACKED) {
    batch_c[lane] = vec4(unpack2x16float(second.z), unpack2x16float(second.w & 0xffffu).x, 0.0);
  } else {
    batch_c[lane] = vec4(colours[splat].xyz, drawn.rest.y);
  }
  marked(lane, drawn, tile);
}

struct Pixel { rgb: vec3<f32>, light: f32, z: f32 }

fn written(i: u32, p: Pixel) {
  let alpha = 1.0 - p.light;
  let rgb = min(p.rgb, vec3(view.brightest));
  if (COMPACT) {
    picture[i] = vec2(pack2x16unorm(rgb.xy), pack2x16unorm(vec2(rgb.z, alpha)));
  } else {
    picture[2u * i] = bitcast<vec2<u32>>(rgb.xy);
    picture[2u * i + 1u] = bitcast<vec2<u32>>(vec2(rgb.z, alpha));
  }
  let known = alpha >= view.void_alpha && alpha > 0.0;
  depth[i] = select(VOID, bitcast<u32>(p.z / alpha), known);
}

// Whether any pixel is not finished. Afterwards all are done with the batch before, and no entry of the next is marked.
fn going(lane: u32, finished: bool) -> bool {
  if (lane == 0u) { atomicStore(&open, 0u); }
  workgroupBarrier();
  if (lane < 4u * WORDS) { atomicStore(&touching[lane], 0u); }
  if (!finished) { atomicOr(&open, 1u); }
  workgroupBarrier();
  if (lane == 0u) { going_on = atomicLoad(&open); }
  return workgroupUniformLoad(&going_on) != 0u;
}

// Alpha of entry `k` of the batch at a pixel centre; 0 where it is not drawn.
fn alpha_at(k: u32, at: vec2<f32>) -> f32 {
  let a = batch_a[k]; let b = batch_b[k];
  let d = (at - a.xy) - vec2(b.w, batch_c[k].w);
  let s = a.z * d.x + a.w * d.y; let t = b.x * d.y;
  let power = b.y - s * s - t * t;
  if (!(power >= LOG2_ALPHA_CUT)) { return 0.0; }
  return min(ALPHA_MAX, exp2(power));
}

fn composited(p: ptr<function, Pixel>, k: u32, weight: f32) {
  (*p).rgb += weight * batch_c[k].xyz;
  (*p).z += weight * batch_b[k].z;
  (*p).light -= weight;
}

@compute @workgroup_size(16, 16)
fn blend(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  let tile = tile_of(group.xy);
  let pixel = pixel_of(tile, lane);
  let inside = all(pixel < view.size);
  let range = ranges[group.y * view.tiles.x + group.x];
  var p = Pixel(vec3(0.0), 1.0, 0.0);
  var finished = !inside;
  for (var begin = range.x; begin < range.y; begin += BATCH) {
    if (!going(lane, finished)) { break; }
    let count = min(BATCH, range.y - begin);
    if (lane < count) { fetched(lane, entry_value[begin + lane], tile); }
    workgroupBarrier();
    for (var word = 0u; word < WORDS; word++) {
      var waiting = atomicLoad(&touching[lane / 64u * WORDS + word]);
      while (waiting != 0u && !finished) {
        let k = 32u * word + countTrailingZeros(waiting);
        waiting &= waiting - 1u;
        let alpha = alpha_at(k, vec2<f32>(pixel) + 0.5);
        if (alpha == 0.0) { continue; }
        composited(&p, k, p.light * alpha);
        finished = p.light <= view.stop;
      }
    }
  }
  if (inside) { written(first_pixel(group.xy) + pixel.y * view.size.x + pixel.x, p); }
}

@compute @workgroup_size(16, 16)
fn blend_counting(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  let tile = tile_of(group.xy);
  let pixel = pixel_of(tile, lane);
  let inside = all(pixel < view.size);
  let range = ranges[group.y * view.tiles.x + group.x];
  var p = Pixel(vec3(0.0), 1.0, 0.0);
  var finished = !inside;
  for (var begin = range.x; begin < range.y; begin += BATCH) {
    if (!going(lane, finished)) { break; }
    let count = min(BATCH, range.y - begin);
    if (lane < count) {
      fetched(lane, slot_splat[entry_value[begin + lane]], tile);
      atomicStore(&weights[lane], 0u);
    }
    workgroupBarrier();
    for (var word = 0u; word < WORDS; word++) {
      var waiting = atomicLoad(&touching[lane / 64u * WORDS + word]);
      while (waiting != 0u && !finished) {
        let k = 32u * word + countTrailingZeros(waiting);
        waiting &= waiting - 1u;
        let alpha = alpha_at(k, vec2<f32>(pixel) + 0.5);
        if (alpha == 0.0) { continue; }
        let weight = p.light * alpha;
        composited(&p, k, weight);
        atomicAdd(&weights[k], u32(weight * UNIT + 0.5));
        finished = p.light <= view.stop;
      }
    }
    workgroupBarrier();
    if (lane < count) { slots[entry_value[begin + lane]] = atomicLoad(&weights[lane]); }
  }
  if (inside) { written(first_pixel(group.xy) + pixel.y * view.size.x + pixel.x, p); }
}
