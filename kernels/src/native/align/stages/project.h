// Projection into the reference, and the colours found there.
#pragma once
#include "align/stages/bilinear.h"

#include <bit>
#include <limits>

namespace cags::align {
namespace {

void project(const CagsAlignInput& in, const CagsAlignOutput& out, int row, float* z, uint8_t* state, Nearest* nearest) {
  const int64_t start = int64_t{row} * in.width;
  const float* depth = in.depth + start;
  float *x = out.x + start, *y = out.y + start;
  z += start;
  state += start;
  const float v = static_cast<float>(row) + 0.5f;
  const float rx = in.m[1] * v + in.m[2], ry = in.m[4] * v + in.m[5], rz = in.m[7] * v + in.m[8];
  const float right = static_cast<float>(in.reference_width), bottom = static_cast<float>(in.reference_height);
  constexpr float kLargest = std::numeric_limits<float>::max();
  for (int i = 0; i < in.width; i++) {
    const float u = static_cast<float>(i) + 0.5f, d = depth[i];
    const float pz = d * (in.m[6] * u + rz) + in.b[2];
    const float inverse = 1.0f / pz;
    const float px = (d * (in.m[0] * u + rx) + in.b[0]) * inverse, py = (d * (in.m[3] * u + ry) + in.b[1]) * inverse;
    // Comparisons with NaN are false, so that void, infinite and overflowing pixels fall out here.
    const bool inside = (d > 0) & (d <= kLargest) & (pz > 0) & (pz <= kLargest) & (px >= 0) & (py >= 0) & (px <= right) & (py <= bottom);
    x[i] = inside ? px : 0.0f;
    y[i] = inside ? py : 0.0f;
    z[i] = inside ? pz : kLargest;
    state[i] = inside ? kSeen : kOutside;
  }
  const int stride = in.reference_width + 1;
  for (int i = 0; i < in.width; i++) {
    if (state[i] != kSeen) continue;
    Nearest& cell = nearest[static_cast<int>(y[i]) * stride + static_cast<int>(x[i])];
    const Nearest mine = (Nearest{std::bit_cast<uint32_t>(z[i])} << 32) | static_cast<uint32_t>(start + i);
    cell = std::min(cell, mine);
  }
}

void sample(const CagsAlignInput& in, const CagsAlignOutput& out, const Padded& reference, const uint8_t* state, int row) {
  const int64_t start = int64_t{row} * in.width;
  float* rgb = out.rgb + 3 * start;
  for (int i = 0; i < in.width; i++, rgb += 3) {
    Lanes<kColourLanes> colour = {};
    if (state[start + i] != kOutside) colour = bilinear<kColourLanes>(reference, out.x[start + i], out.y[start + i]);
    if (i + 1 < in.width) {
      std::memcpy(rgb, &colour, sizeof colour);  // the fourth float is the next pixel's, written next
    } else {
      std::memcpy(rgb, &colour, 3 * sizeof(float));
    }
  }
}

}  // namespace
}  // namespace cags::align
