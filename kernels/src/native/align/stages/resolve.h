// What the reference shows of each client pixel: occlusion, confidence, colour.
#pragma once
#include "align/bits.h"
#include "align/stages/bilinear.h"
#include "align/stages/projection.h"

#include <bit>
#include <cmath>
#include <cstdlib>

namespace cags::align {
namespace {

void nearest(const CagsAlignInput& in, int row, Nearest* cells) {
  Projected p;
  for (int first = 0; first < in.view.width; first += kRun * in.stride) {
    const int left = (in.view.width - first + in.stride - 1) / in.stride, count = std::min(kRun, left);
    if (!project(in.view, row, first, in.stride, count, p)) continue;
    const uint32_t place = place_of(row, first);
    for (int i = 0; i < count; i++) {
      if (!p.inside[i]) continue;
      const Nearest mine = (Nearest{std::bit_cast<uint32_t>(p.z[i])} << 32) | (place + static_cast<uint32_t>(i * in.stride));
      cells[p.cell[i]] = std::min(cells[p.cell[i]], mine);
    }
  }
}

// The smaller of the steps to the two neighbours `step` apart; a void neighbour or the picture's edge does not count.
inline float slope(const float* depth, int64_t pixel, int64_t step, bool has_before, bool has_after) {
  const auto known = [&](int64_t i) { return depth[i] > 0 && std::isfinite(depth[i]); };
  float smallest = std::numeric_limits<float>::infinity();
  if (has_before && known(pixel - step)) smallest = std::fabs(depth[pixel] - depth[pixel - step]);
  if (has_after && known(pixel + step)) smallest = std::min(smallest, std::fabs(depth[pixel + step] - depth[pixel]));
  return std::isfinite(smallest) ? smallest : 0.0f;
}

// Whether a pixel that lies `behind` its cell's limit is hidden: behind even by the surface's own slope, and not within one
// reference pixel of the nearest in the client's view too, where the reference sees both.
inline bool hidden(const CagsAlignInput& in, int row, int column, float behind, Nearest nearest) {
  const int width = in.view.width, height = in.view.height;
  const uint32_t place = static_cast<uint32_t>(nearest);
  const int rows_away = std::abs(row - row_of(place)), columns_away = std::abs(column - column_of(place));
  if (columns_away <= in.cell_x && rows_away <= in.cell_y) return false;
  const int64_t pixel = int64_t{row} * width + column;
  const float across = slope(in.view.depth, pixel, 1, column > 0, column + 1 < width);
  const float down = slope(in.view.depth, pixel, width, row > 0, row + 1 < height);
  return behind > in.slope_cells * (in.cell_x * across + in.cell_y * down);
}

// The first `count` values that are more than 0, a bit a value.
inline uint64_t positive(const float* values, int count) {
  uint64_t out = 0;
#if defined(__AVX2__)
  for (int i = 0; i < kRun; i += 8) {
    const __m256 more = _mm256_cmp_ps(_mm256_loadu_ps(values + i), _mm256_setzero_ps(), _CMP_GT_OQ);
    out |= uint64_t{static_cast<uint32_t>(_mm256_movemask_ps(more))} << i;
  }
  return out & ~uint64_t{0} >> (kRun - count);
#else
  for (int i = 0; i < count; i++) out |= uint64_t{values[i] > 0} << i;
  return out;
#endif
}
static_assert(kRun == kWord);

// Confidence of a run where nothing is hidden, and how far its pixels lie behind their cells' limits. Returns those that do, a bit a pixel.
inline uint64_t confide(const CagsAlignInput& in, const Projected& p, const float* nearest_depth, int count,
                     float* __restrict confidence, float* __restrict behind) {
  const float tolerance = 1.0f + in.depth_tolerance, fade = 1.0f / std::max(in.border_px, 1e-6f);
  const float w = static_cast<float>(in.view.reference_width), h = static_cast<float>(in.view.reference_height);
  for (int i = 0; i < count; i++) {
    const float x = p.x[i], y = p.y[i], across = x < w - x ? x : w - x, down = y < h - y ? y : h - y;
    const float distance = (across < down ? across : down) * fade;
    confidence[i] = p.inside[i] ? (distance < 1.0f ? distance : 1.0f) : 0.0f;
  }
  for (int i = 0; i < count; i++) behind[i] = p.z[i] - nearest_depth[p.cell[i]] * tolerance;
  return positive(behind, count);
}

// Marks those of a run's `doubtful` pixels that are hidden.
inline void hide(const CagsAlignInput& in, const Projected& p, const Occlusion& occlusion, const float* behind, uint64_t doubtful,
                 int row, int first, float* confidence, uint8_t* occluded) {
  for (; doubtful; doubtful &= doubtful - 1) {
    const int i = std::countr_zero(doubtful);
    if (!hidden(in, row, first + i, behind[i], occlusion.nearest[p.cell[i]])) continue;
    occluded[i] = 1;
    confidence[i] = 0.0f;
    if (occlusion.shared) occlusion.shared[p.cell[i]] = 1;
  }
}

inline void paint(const Projected& p, const Padded& reference, int count, float* rgb) {
  const Taps taps(reference, p, count);
  for (int i = 0; i < count; i++) put(rgb, i, count, p.inside[i] ? bilinear(reference, taps[i]) : Four{});
}

void resolve(const CagsAlignInput& in, const Padded& reference, const Occlusion& occlusion, int row, const CagsAlignOutput& out) {
  Projected p;
  float behind[kRun];
  for (int first = 0; first < in.view.width; first += kRun) {
    const int count = std::min(kRun, in.view.width - first);
    const int64_t start = int64_t{row} * in.view.width + first;
    float* confidence = out.confidence + start;
    float* rgb = out.rgb ? out.rgb + 3 * start : nullptr;
    std::memset(out.occluded + start, 0, count);
    if (project(in.view, row, first, 1, count, p)) {
      const uint64_t doubtful = confide(in, p, occlusion.nearest_depth, count, confidence, behind);
      hide(in, p, occlusion, behind, doubtful, row, first, confidence, out.occluded + start);
      if (rgb) paint(p, reference, count, rgb);
    } else {  // nothing of it lies in the reference
      std::fill_n(confidence, count, 0.0f);
      if (rgb) std::fill_n(rgb, 3 * count, 0.0f);
    }
  }
}

uint64_t clean(const CagsAlignInput& in, const uint8_t* occluded, const uint8_t* shared, int row, int first, int count) {
  Projected p;
  if (!project(in.view, row, first, 1, count, p)) return 0;
  uint8_t flags[kWord] = {};
  for (int i = 0; i < count; i++) flags[i] = p.inside[i] & !(occluded[i] | shared[p.cell[i]]);
  return word_of(flags, kWord);
}

}  // namespace
}  // namespace cags::align
