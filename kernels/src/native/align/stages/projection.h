// Where a run of client pixels lies in the reference.
#pragma once
#include "align/stages.h"

#include <limits>

namespace cags::align {
namespace {

struct Projected {
  float x[kRun], y[kRun], z[kRun];  // 0, 0, 0 where not inside
  int32_t cell[kRun];               // row and column of the reference pixel, as one index
  int32_t inside[kRun];             // 0 or 1; as wide as a float, so that the loop is one vector wide
};

// Pixels first, first + step, ... (count of them) of a row. Returns whether any is inside.
inline bool project(const CagsReprojection& view, int row, int first, int step, int count, Projected& out) {
  const float* depth = view.depth + int64_t{row} * view.width + first;
  const float v = static_cast<float>(row) + 0.5f;
  const float* m = view.m;
  const float rx = m[1] * v + m[2], ry = m[4] * v + m[5], rz = m[7] * v + m[8];
  const float right = static_cast<float>(view.reference_width), bottom = static_cast<float>(view.reference_height);
  const int stride = view.reference_width + 1;
  constexpr float kLargest = std::numeric_limits<float>::max();
  int32_t any = 0;
  for (int i = 0; i < count; i++) {
    const float u = static_cast<float>(first + i * step) + 0.5f, d = depth[i * step];
    const float z = d * (m[6] * u + rz) + view.b[2];
    const float inverse = 1.0f / z;
    const float x = (d * (m[0] * u + rx) + view.b[0]) * inverse, y = (d * (m[3] * u + ry) + view.b[1]) * inverse;
    // Comparisons with NaN are false, so that void, infinite and overflowing pixels fall out here.
    const bool inside = (d > 0) & (d <= kLargest) & (z > 0) & (z <= kLargest) & (x >= 0) & (y >= 0) & (x <= right) & (y <= bottom);
    const float sx = inside ? x : 0.0f, sy = inside ? y : 0.0f;
    out.x[i] = sx;
    out.y[i] = sy;
    out.z[i] = inside ? z : 0.0f;
    out.cell[i] = static_cast<int32_t>(sy) * stride + static_cast<int32_t>(sx);
    out.inside[i] = inside;
    any |= inside;
  }
  return any;
}

}  // namespace
}  // namespace cags::align
