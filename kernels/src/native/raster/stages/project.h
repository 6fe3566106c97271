// Stage 1: projection, culling, records. EWA splatting (Zwicker et al. 2001) as in Kerbl et al. 2023.
#pragma once
#include "raster/layout.h"
#include "raster/stages/colour.h"
#include "raster/stages/exponential.h"
#include "raster/stages/vector.h"

namespace cags::raster {
namespace {

constexpr float kSlack = 1e-3f;  // pixels added to every extent: rounding may widen a splat's box but never cut it

// A block of kLanes projected splats.
struct Projected {
  alignas(64) float u[kLanes], v[kLanes], u_rest[kLanes], v_rest[kLanes];
  alignas(64) float l11[kLanes], l12[kLanes], l22[kLanes], log2_opacity[kLanes], z[kLanes];
  alignas(64) float x0[kLanes], x1[kLanes], y0[kLanes], y1[kLanes];  // pixels, inclusive, inside the image
  alignas(64) float toward[3][kLanes];                               // from the camera to the splat, world, not unit
  uint32_t visible;                                                  // one bit a lane
};

struct CameraPoint {
  Floats x, y, inverse_z, z;  // x / z, y / z, 1 / z; z rounded to float32: it decides culling and order
  Ints in_front;
};

// In double precision: a scene may lie 1e6 units from the origin with the camera beside it.
inline CameraPoint to_camera(const SceneData& scene, const View& view, int i, int lane, Projected& out) {
  const double* r = view.rotation;
  Doubles d[3];
  for (int k = 0; k < 3; k++) {
    d[k] = widen(load(scene.mean[k] + i)) - view.position[k];
    store(out.toward[k] + lane, narrow(d[k]));
  }
  const Doubles x = r[0] * d[0] + r[1] * d[1] + r[2] * d[2], y = r[3] * d[0] + r[4] * d[1] + r[5] * d[2];
  const Doubles z = r[6] * d[0] + r[7] * d[1] + r[8] * d[2];
  CameraPoint p;
  p.z = narrow(z);
  p.in_front = (p.z > view.near_plane) & (p.z < kMaxDepth);
  const Doubles inverse = 1.0 / widen(select(p.in_front, p.z, all(1.0f)));
  // Newton's step with the unrounded z; where z is not in front the result is masked later.
  const Doubles refined = inverse * (2.0 - z * inverse), nx = x * refined, ny = y * refined;
  const Doubles u = nx * view.fx + view.cx, v = ny * view.fy + view.cy;
  const Floats u_near = narrow(u), v_near = narrow(v);
  store(out.u + lane, u_near);
  store(out.v + lane, v_near);
  store(out.u_rest + lane, narrow(u - widen(u_near)));
  store(out.v_rest + lane, narrow(v - widen(v_near)));
  p.x = narrow(nx), p.y = narrow(ny), p.inverse_z = narrow(refined);
  return p;
}

struct Covariance {
  Floats xx, xy, yy;      // squared pixels, before dilation
  Floats minors_over_yy;  // det / (yy + variance), by the factor's 2x2 minors: no cancellation on needles
  Floats inverse_yy;      // 1 / (yy + variance)
};

inline Covariance covariance(const SceneData& scene, const View& view, int i, const CameraPoint& p) {
  const double* r = view.rotation;
  const Floats tx = clamp(p.x, all(-view.limit_x), all(view.limit_x)), ty = clamp(p.y, all(-view.limit_y), all(view.limit_y));
  const Floats jx = p.inverse_z * float(view.fx), jy = p.inverse_z * float(view.fy);
  Floats row_x[3], row_y[3], a[3], b[3];
  for (int k = 0; k < 3; k++) {
    row_x[k] = jx * (float(r[k]) - tx * float(r[6 + k]));
    row_y[k] = jy * (float(r[3 + k]) - ty * float(r[6 + k]));
  }
  for (int k = 0; k < 3; k++) {
    const Floats m0 = load(scene.axes[k] + i), m1 = load(scene.axes[3 + k] + i), m2 = load(scene.axes[6 + k] + i);
    a[k] = row_x[0] * m0 + row_x[1] * m1 + row_x[2] * m2;
    b[k] = row_y[0] * m0 + row_y[1] * m1 + row_y[2] * m2;
  }
  Covariance c;
  c.xx = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
  c.xy = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  c.yy = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
  c.inverse_yy = 1.0f / (c.yy + view.variance);
  const Floats scale = square_root(c.inverse_yy);
  const Floats n0 = (a[1] * b[2] - a[2] * b[1]) * scale, n1 = (a[2] * b[0] - a[0] * b[2]) * scale;
  const Floats n2 = (a[0] * b[1] - a[1] * b[0]) * scale;
  c.minors_over_yy = n0 * n0 + n1 * n1 + n2 * n2;
  return c;
}

// det(S + e I) / (yy + variance).
inline Floats determinant_over_yy(const Covariance& c, float e) {
  return c.minors_over_yy + e * ((c.xx + c.yy + e) * c.inverse_yy);
}

// Pixels [first, last] whose centres lie within `extent` of `centre`, clipped to an axis of `size` pixels.
inline Ints pixel_range(const float* centre, Floats extent, int size, float* first, float* last) {
  const Floats c = load(centre);
  // Clamped before it is rounded: floats beyond 2^23 are whole already. Truncation after + 1 is floor for all >= -1.
  const Floats low = clamp(c - extent, all(-1.0f), all(float(size))), high = clamp(c + extent, all(-1.0f), all(float(size)));
  const Floats floor_high = __builtin_convertvector(__builtin_convertvector(high + 1.0f, Ints), Floats) - 1.0f;
  const Floats ceil_low = float(size) - __builtin_convertvector(__builtin_convertvector(float(size) - low, Ints), Floats);
  const Floats a = greater(ceil_low, all(0.0f)), b = lesser(floor_high, all(float(size - 1)));
  store(first, a);
  store(last, b);
  return a <= b;
}

inline uint32_t project_lanes(const SceneData& scene, const View& view, int i, int lane, Projected& out) {
  const CameraPoint p = to_camera(scene, view, i, lane, out);
  if (!bits(p.in_front)) return 0;
  const Covariance c = covariance(scene, view, i, p);
  const Floats conditional = determinant_over_yy(c, view.variance);  // variance of x given y
  Floats strength = load(scene.log2_opacity + i);
  if (view.variance != view.dilation) {
    const Floats kept = determinant_over_yy(c, view.dilation) / conditional;
    strength += 0.5f * log2(greater(kept, all(1e-30f)));
  }
  const Floats reach = strength - kLog2AlphaCut;  // in the exponent's units
  Ints visible = p.in_front & (reach > 0.0f) & (conditional > 0.0f);
  const float unit = std::sqrt(kHalfLog2E);
  const Floats l11 = unit / square_root(conditional), l22 = unit * square_root(c.inverse_yy);
  const Floats radius = square_root(greater(reach, all(0.0f))) * (1.0f / unit);
  const Floats extent_x = radius * square_root(c.xx + view.variance) * 1.000001f + kSlack;
  const Floats extent_y = radius * square_root(c.yy + view.variance) * 1.000001f + kSlack;
  visible &= pixel_range(out.u + lane, extent_x, view.width, out.x0 + lane, out.x1 + lane);
  visible &= pixel_range(out.v + lane, extent_y, view.height, out.y0 + lane, out.y1 + lane);
  store(out.l11 + lane, l11);
  store(out.l12 + lane, -(c.xy * c.inverse_yy) * l11);
  store(out.l22 + lane, l22);
  store(out.log2_opacity + lane, strength);
  store(out.z + lane, p.z);
  return bits(visible) << lane;
}

inline void write_record(const Projected& p, const Colours& colours, int lane, uint32_t tie, uint32_t slot, Record& out) {
  out.u = p.u[lane], out.v = p.v[lane], out.u_rest = p.u_rest[lane], out.v_rest = p.v_rest[lane];
  out.l11 = p.l11[lane], out.l12 = p.l12[lane], out.l22 = p.l22[lane], out.log2_opacity = p.log2_opacity[lane];
  out.r = colours.rgb[0][lane], out.g = colours.rgb[1][lane], out.b = colours.rgb[2][lane], out.z = p.z[lane];
  out.tile_x0 = uint16_t(int(p.x0[lane]) / kTile), out.tile_x1 = uint16_t(int(p.x1[lane]) / kTile);
  out.tile_y0 = uint16_t(int(p.y0[lane]) / kTile), out.tile_y1 = uint16_t(int(p.y1[lane]) / kTile);
  out.tie = tie, out.slot = slot;
}

void project(const SceneData& scene, const View& view, const FrameData& frame, int chunk) {
  const int begin = chunk * frame.chunk_size;
  const int end = begin + frame.chunk_size < scene.padded ? begin + frame.chunk_size : scene.padded;
  const int tiles = view.tiles_x * view.tiles_y;
  uint32_t* counts = frame.tile_cursor + size_t(chunk) * tiles;
  std::memset(counts, 0, sizeof(uint32_t) * tiles);
  int record = begin;
  uint32_t slot = 0;
  Projected p;
  Colours colours;
  for (int i = begin; i < end; i += kLanes) {
    p.visible = 0;
    for (int lane = 0; lane < kLanes; lane += kWidth) p.visible |= project_lanes(scene, view, i + lane, lane, p);
    if (!p.visible) continue;
    colours_of(scene, view, i, p.toward, colours);
    for (uint32_t left = p.visible; left; left &= left - 1) {
      const int lane = __builtin_ctz(left);
      Record& out = frame.records[record];
      write_record(p, colours, lane, scene.tie[i + lane], slot, out);
      frame.splat[record++] = i + lane;
      for (int y = out.tile_y0; y <= out.tile_y1; y++)
        for (int x = out.tile_x0; x <= out.tile_x1; x++) counts[y * view.tiles_x + x]++;
      slot += uint32_t(out.tile_x1 - out.tile_x0 + 1) * uint32_t(out.tile_y1 - out.tile_y0 + 1);
    }
  }
  frame.chunk_records[chunk] = record - begin;
  frame.chunk_slot[chunk] = slot;
}

void scatter(const View& view, const FrameData& frame, int chunk) {
  const int begin = chunk * frame.chunk_size, end = begin + frame.chunk_records[chunk];
  uint32_t* cursor = frame.tile_cursor + size_t(chunk) * view.tiles_x * view.tiles_y;
  for (int i = begin; i < end; i++) {
    const Record& r = frame.records[i];
    uint32_t depth_bits;
    std::memcpy(&depth_bits, &r.z, sizeof depth_bits);  // z > 0: its bits order as it does
    const uint64_t entry = uint64_t(depth_bits) << 32 | uint32_t(i);
    for (int y = r.tile_y0; y <= r.tile_y1; y++)
      for (int x = r.tile_x0; x <= r.tile_x1; x++) frame.entries[cursor[y * view.tiles_x + x]++] = entry;
  }
}

}  // namespace
}  // namespace cags::raster
