// The client's frame after drawing: what the server says is lacking, brought to the client's view by the client's own depth
// (PRPA: projection, z-test, border) and laid over; hidden pixels get the mean of what was added around them. Every pass stores
// what later ones compare: recomputed it need not be the same bits.
struct Correction {
  m0: vec4<f32>, m1: vec4<f32>, m2: vec4<f32>,       // rows of m, b in the fourth: (x z, y z, z) = D m (u, v, 1) + b
  size: vec2<u32>, reference: vec2<u32>,
  cell: vec2<f32>, stride: u32, tolerance: f32,      // cell: client pixels a reference pixel
  slope_cells: f32, border: f32, knee: f32, hole_alpha: f32,
  grid: vec2<u32>, unused: u32,
  veto_cell: u32,                                    // pixels a side of a veto's values, 0: there is none
}
@group(0) @binding(0) var<uniform> job: Correction;
@group(0) @binding(1) var<storage, read> picture: array<vec2<u32>>;         // the client's own, as blend.wgsl leaves it
@group(0) @binding(2) var<storage, read> depth: array<u32>;                 // bits of a float; +inf where void or thin
@group(0) @binding(3) var<storage, read_write> cells: array<vec2<f32>>;     // inverse depth and weight, level after level
@group(0) @binding(4) var<storage, read_write> filled: array<u32>;          // depth without holes, bits
@group(0) @binding(5) var<storage, read_write> places: array<vec2<u32>>;    // bits of z in the reference, and the pixel there, or HIDDEN, or OUTSIDE
@group(0) @binding(6) var<storage, read_write> nearest: array<atomic<u32>>; // bits of the least z of each reference pixel; then of equally near ones the first
@group(0) @binding(7) var<storage, read> veto: array<f32>;                  // share of the confidence that is taken away
@group(0) @binding(8) var<storage, read> coded: array<f32>;                 // the decoded reference [h][w][3] in [0, 1]
@group(0) @binding(9) var<storage, read_write> lack: array<vec4<f32>>;     // what is laid over, at the reference's pixels: premultiplied colour, opacity
@group(0) @binding(10) var<storage, read_write> shown: array<u32>;          // 8 bits a channel; with FLOATS four floats
@group(0) @binding(11) var<storage, read_write> sums: array<vec4<f32>>;     // of the finest cells: what was added, confidence
override COMPACT: bool = false;     // the picture has 16 bits a channel
override FLOATS: bool = false;
override CONFIDENCE: bool = false;  // in the place of the bytes' alpha
const CELL = 8u;         // pixels a side of the grid that fills holes in the depth
const VOID = 0x7f800000u;
const OUTSIDE = 0xffffffffu;
const HIDDEN = 0xfffffffeu;
const FAR = 1e6;         // depth where nothing is known anywhere, and the largest that counts, world units
const LEAST_DEPTH = 0x358637bdu;  // bits of 1 / FAR: what is nearer is not known
const LEAST_WEIGHT = 1e-6;
const LEAST_AROUND = 1.0;  // confident pixels of a cell: what is fewer says less of the hidden pixels around
const ZERO = 110.0 / 219.0; const SPAN = 109.0 / 219.0; const STILL = 1e-5;  // see cags_common.correction.compander

fn known(bits: u32) -> bool { return bits >= LEAST_DEPTH && bits < VOID; }

// What a difference says is lacking: the compander undone. Of pictures see compare.wgsl.
@compute @workgroup_size(16, 16) fn expand(@builtin(global_invocation_id) id: vec3<u32>) {
  if (any(id.xy >= job.reference)) { return; }
  let i = id.y * job.reference.x + id.x;
  let p = vec3(coded[3u * i], coded[3u * i + 1u], coded[3u * i + 2u]);
  let away = p - ZERO;
  let turned = clamp(away / SPAN, vec3(-1.0), vec3(1.0)) * asinh(1.0 / job.knee);
  let difference = select(sinh(turned) * job.knee, vec3(0.0), abs(away) <= vec3(STILL));
  lack[i] = vec4(difference, 0.0);
}

// Inverse depth of each cell, and the share of its pixels that have one.
@compute @workgroup_size(8, 8) fn average(@builtin(global_invocation_id) id: vec3<u32>) {
  if (any(id.xy >= job.grid)) { return; }
  var sum = vec2(0.0);
  let end = min((id.xy + 1u) * CELL, job.size);
  for (var y = id.y * CELL; y < end.y; y++) {
    for (var x = id.x * CELL; x < end.x; x++) {
      let i = y * job.size.x + x;
      if (known(depth[i])) {
        sum += vec2(1.0 / min(bitcast<f32>(depth[i]), FAR), 1.0);
      }
    }
  }
  let pixels = f32((end.x - id.x * CELL) * (end.y - id.y * CELL));
  cells[id.y * job.grid.x + id.x] = vec2(sum.x / max(sum.y, LEAST_WEIGHT), sum.y / pixels);
}

// Pull and push (Gortler et al. 1996, "The Lumigraph") over all levels of the grid; one workgroup.
fn pulled(lane: u32, fine: u32, size: vec2<u32>, coarse: u32, half: vec2<u32>) {
  for (var i = lane; i < half.x * half.y; i += 256u) {
    let at = 2u * vec2(i % half.x, i / half.x);
    let end = min(at + 2u, size);
    var sum = vec2(0.0);
    for (var y = at.y; y < end.y; y++) {
      for (var x = at.x; x < end.x; x++) {
        let c = cells[fine + y * size.x + x];
        sum += vec2(c.x * c.y, c.y);
      }
    }
    cells[coarse + i] = vec2(sum.x / max(sum.y, LEAST_WEIGHT), min(sum.y, 1.0));
  }
}

fn sampled_cell(level: u32, size: vec2<u32>, at: vec2<f32>) -> f32 {
  let f = clamp(at - 0.5, vec2(0.0), vec2<f32>(size) - 1.0);
  let lo = vec2<u32>(floor(f)); let hi = min(lo + 1u, size - 1u); let a = f - vec2<f32>(lo);
  let top = mix(cells[level + lo.y * size.x + lo.x].x, cells[level + lo.y * size.x + hi.x].x, a.x);
  let bottom = mix(cells[level + hi.y * size.x + lo.x].x, cells[level + hi.y * size.x + hi.x].x, a.x);
  return mix(top, bottom, a.y);
}

fn pushed(lane: u32, fine: u32, size: vec2<u32>, coarse: u32, half: vec2<u32>) {
  for (var i = lane; i < size.x * size.y; i += 256u) {
    let at = (vec2<f32>(vec2(i % size.x, i / size.x)) + 0.5) * 0.5;
    let c = cells[fine + i];
    cells[fine + i].x = mix(sampled_cell(coarse, half, at), c.x, min(c.y, 1.0));
  }
}

@compute @workgroup_size(256) fn fill(@builtin(local_invocation_index) lane: u32) {
  var at = array<u32, 16>(); var sizes = array<vec2<u32>, 16>();
  sizes[0] = job.grid;
  var levels = 1u;
  while (levels < 16u && (sizes[levels - 1u].x > 1u || sizes[levels - 1u].y > 1u)) {
    let fine = sizes[levels - 1u];
    at[levels] = at[levels - 1u] + fine.x * fine.y;
    sizes[levels] = (fine + 1u) / 2u;
    pulled(lane, at[levels - 1u], fine, at[levels], sizes[levels]);
    storageBarrier();
    levels++;
  }
  for (var k = levels - 1u; k > 0u; k--) {
    pushed(lane, at[k - 1u], sizes[k - 1u], at[k], sizes[k]);
    storageBarrier();
  }
}

fn reference_cells() -> u32 { return (job.reference.x + 1u) * (job.reference.y + 1u); }

@compute @workgroup_size(256) fn reset(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x >= 2u * reference_cells()) { return; }
  atomicStore(&nearest[id.x], 0xffffffffu);
}

struct Place { xy: vec2<f32>, z: f32 }

fn placed(pixel: vec2<u32>, d: f32) -> Place {
  let ray = vec3(vec2<f32>(pixel) + 0.5, 1.0);
  let z = d * dot(job.m2.xyz, ray) + job.m2.w;
  return Place(vec2(d * dot(job.m0.xyz, ray) + job.m0.w, d * dot(job.m1.xyz, ray) + job.m1.w) / z, z);
}

// Depth without holes, and where each pixel lies in the reference.
@compute @workgroup_size(16, 16) fn place(@builtin(global_invocation_id) id: vec3<u32>) {
  if (any(id.xy >= job.size)) { return; }
  let i = id.y * job.size.x + id.x;
  var bits = depth[i];
  if (!known(bits)) {
    let cell = (vec2<f32>(id.xy) + 0.5) / f32(CELL);
    bits = bitcast<u32>(1.0 / max(sampled_cell(0u, job.grid, cell), 1.0 / FAR));
  }
  bits = bitcast<u32>(min(bitcast<f32>(bits), FAR));
  filled[i] = bits;
  let p = placed(id.xy, bitcast<f32>(bits));
  var there = OUTSIDE;
  if (p.z > 0.0 && all(p.xy >= vec2(0.0)) && all(p.xy <= vec2<f32>(job.reference))) {
    there = u32(p.xy.y) * (job.reference.x + 1u) + u32(p.xy.x);
    if (id.x % job.stride == 0u && id.y % job.stride == 0u) { atomicMin(&nearest[there], bitcast<u32>(p.z)); }
  }
  places[i] = vec2(bitcast<u32>(p.z), there);
}

@compute @workgroup_size(16, 16) fn claim(@builtin(global_invocation_id) id: vec3<u32>) {
  let pixel = id.xy * job.stride;
  if (any(pixel >= job.size)) { return; }
  let i = pixel.y * job.size.x + pixel.x;
  let p = places[i];
  if (p.y != OUTSIDE && p.x == atomicLoad(&nearest[p.y])) { atomicMin(&nearest[reference_cells() + p.y], i); }
}

fn depth_step(i: u32, j: u32) -> f32 { return abs(bitcast<f32>(filled[i]) - bitcast<f32>(filled[j])); }

// Depth change over a reference pixel of the surface's own slope: the smaller of the two steps along each axis.
fn slack(id: vec2<u32>, i: u32) -> f32 {
  let w = job.size.x;
  var across = 3e38; var down = 3e38;
  if (id.x > 0u) { across = depth_step(i, i - 1u); }
  if (id.x + 1u < w) { across = min(across, depth_step(i, i + 1u)); }
  if (id.y > 0u) { down = depth_step(i, i - w); }
  if (id.y + 1u < job.size.y) { down = min(down, depth_step(i, i + w)); }
  across = select(across, 0.0, across >= 3e38); down = select(down, 0.0, down >= 3e38);
  return job.slope_cells * (job.cell.x * across + job.cell.y * down);
}

fn hidden(id: vec2<u32>, i: u32, p: vec2<u32>) -> bool {
  let limit = bitcast<f32>(min(atomicLoad(&nearest[p.y]), 0x7f7fffffu)) * (1.0 + job.tolerance) + slack(id, i);
  let f = atomicLoad(&nearest[reference_cells() + p.y]);
  let at = vec2<f32>(vec2(f % job.size.x, f / job.size.x));
  return bitcast<f32>(p.x) > limit && any(abs(vec2<f32>(id) - at) > job.cell);
}

fn lacking(xy: vec2<f32>) -> vec4<f32> {
  let f = clamp(xy - 0.5, vec2(0.0), vec2<f32>(job.reference) - 1.0);
  let lo = vec2<u32>(floor(f)); let hi = min(lo + 1u, job.reference - 1u); let a = f - vec2<f32>(lo);
  let w = job.reference.x;
  let top = mix(lack[lo.y * w + lo.x], lack[lo.y * w + hi.x], a.x);
  let bottom = mix(lack[hi.y * w + lo.x], lack[hi.y * w + hi.x], a.x);
  return mix(top, bottom, a.y);
}

fn vetoed(id: vec2<u32>, i: u32) -> f32 {
  if (job.veto_cell == 0u) { return 0.0; }
  if (job.veto_cell == 1u) { return clamp(veto[i], 0.0, 1.0); }
  let size = (job.size + job.veto_cell - 1u) / job.veto_cell;
  let f = clamp((vec2<f32>(id) + 0.5) / f32(job.veto_cell) - 0.5, vec2(0.0), vec2<f32>(size) - 1.0);
  let lo = vec2<u32>(floor(f)); let hi = min(lo + 1u, size - 1u); let a = f - vec2<f32>(lo);
  let top = mix(veto[lo.y * size.x + lo.x], veto[lo.y * size.x + hi.x], a.x);
  let bottom = mix(veto[hi.y * size.x + lo.x], veto[hi.y * size.x + hi.x], a.x);
  return clamp(mix(top, bottom, a.y), 0.0, 1.0);
}

struct Sample { xy: vec2<f32>, weight: f32 }  // where in the reference, and how much of it is added

// Beyond the reference pixels take its nearest point, fading with the distance; holes do not fade.
fn sample_of(id: vec2<u32>, i: u32, p: vec2<u32>, alpha: f32) -> Sample {
  let most = vec2<f32>(job.reference);
  let at = placed(id, bitcast<f32>(filled[i])).xy;  // what is compared was stored
  let xy = clamp(at, vec2(0.0), most);
  let z = bitcast<f32>(p.x);
  let ahead = z > 0.0 && z < 3e38;
  var weight = select(0.0, 1.0, p.y != OUTSIDE);
  if (p.y == OUTSIDE && ahead) {
    let beyond = abs(at - xy);
    weight = clamp(1.0 - max(beyond.x, beyond.y) / max(job.border, 1e-6), 0.0, 1.0);
  }
  if (alpha < job.hole_alpha && ahead) {
    weight = max(weight, clamp(1.0 - alpha / max(job.hole_alpha, 1e-6), 0.0, 1.0));
  }
  return Sample(xy, weight * (1.0 - vetoed(id, i)));
}

// The client's own colours and opacity.
fn drawn_at(i: u32) -> vec4<f32> {
  if (COMPACT) { return vec4(unpack2x16unorm(picture[i].x), unpack2x16unorm(picture[i].y)); }
  return vec4(bitcast<vec2<f32>>(picture[2u * i]), bitcast<vec2<f32>>(picture[2u * i + 1u]));
}

fn show(i: u32, colour: vec3<f32>, confidence: f32) {
  let rgb = clamp(colour, vec3(0.0), vec3(1.0));
  if (FLOATS) {
    for (var c = 0u; c < 3u; c++) { shown[4u * i + c] = bitcast<u32>(rgb[c]); }
    shown[4u * i + 3u] = bitcast<u32>(confidence);
  } else {
    shown[i] = pack4x8unorm(vec4(rgb, select(1.0, confidence, CONFIDENCE)));
  }
}

var<workgroup> parts: array<vec4<f32>, 256>;

// The frame but for hidden pixels, and the sums over the 2 x 2 cells of the workgroup.
@compute @workgroup_size(16, 16) fn add(
  @builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>, @builtin(local_invocation_index) lane: u32
) {
  var added = vec4(0.0);  // and the confidence
  if (all(id.xy < job.size)) {
    let i = id.y * job.size.x + id.x;
    let p = places[i];
    if (p.y != OUTSIDE && hidden(id.xy, i, p)) {
      places[i].y = HIDDEN;
    } else {
      let drawn = drawn_at(i);
      let at = sample_of(id.xy, i, p, drawn.w);
      if (at.weight > 0.0) {
        let over = lacking(at.xy);
        added = vec4(at.weight * (over.xyz - over.w * drawn.xyz), at.weight);
      }
      show(i, drawn.xyz + added.xyz, added.w);
    }
  }
  parts[lane] = added;
  workgroupBarrier();
  if (local.x % CELL == 0u) {
    for (var k = 1u; k < CELL; k++) { added += parts[lane + k]; }
    parts[lane] = added;
  }
  workgroupBarrier();
  let cell = id.xy / CELL;
  if (all(local.xy % CELL == vec2(0u)) && all(cell < job.grid)) {
    for (var k = 1u; k < CELL; k++) { added += parts[lane + 16u * k]; }
    sums[cell.y * job.grid.x + cell.x] = added;
  }
}

// Hidden pixels: the mean of what was added around them.
@compute @workgroup_size(16, 16) fn surround(@builtin(global_invocation_id) id: vec3<u32>) {
  if (any(id.xy >= job.size)) { return; }
  let i = id.y * job.size.x + id.x;
  let p = places[i];
  if (p.y != HIDDEN) { return; }
  let f = clamp((vec2<f32>(id.xy) + 0.5) / f32(CELL) - 0.5, vec2(0.0), vec2<f32>(job.grid) - 1.0);
  let lo = vec2<u32>(floor(f)); let hi = min(lo + 1u, job.grid - 1u); let a = f - vec2<f32>(lo);
  let w = job.grid.x;
  let top = mix(sums[lo.y * w + lo.x], sums[lo.y * w + hi.x], a.x);
  let bottom = mix(sums[hi.y * w + lo.x], sums[hi.y * w + hi.x], a.x);
  let sum = mix(top, bottom, a.y);
  let drawn = drawn_at(i);
  show(i, drawn.xyz + sample_of(id.xy, i, p, drawn.w).weight * sum.xyz / max(sum.w, LEAST_AROUND), 0.0);
}

// A frame that no reference corrects.
@compute @workgroup_size(16, 16) fn plain(@builtin(global_invocation_id) id: vec3<u32>) {
  if (any(id.xy >= job.size)) { return; }
  let i = id.y * job.size.x + id.x;
  show(i, drawn_at(i).xyz, 0.0);
}
