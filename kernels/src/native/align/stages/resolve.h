// What the reference shows of each client pixel: occlusion, confidence, colour.
#pragma once
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
    project(in.view, row, first, in.stride, count, p);
    const uint32_t index = static_cast<uint32_t>(int64_t{row} * in.view.width + first);
    for (int i = 0; i < count; i++) {
      if (!p.inside[i]) continue;
      const Nearest mine = (Nearest{std::bit_cast<uint32_t>(p.z[i])} << 32) | (index + static_cast<uint32_t>(i * in.stride));
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
  const int64_t first = static_cast<uint32_t>(nearest), pixel = int64_t{row} * width + column;
  const int rows_away = std::abs(row - static_cast<int>(first / width));
  const int columns_away = std::abs(column - static_cast<int>(first % width));
  if (columns_away <= in.cell_x && rows_away <= in.cell_y) return false;
  const float across = slope(in.view.depth, pixel, 1, column > 0, column + 1 < width);
  const float down = slope(in.view.depth, pixel, width, row > 0, row + 1 < height);
  return behind > in.slope_cells * (in.cell_x * across + in.cell_y * down);
}

void resolve(const CagsAlignInput& in, const CagsAlignOutput& out, const Occlusion& occlusion, int row) {
  const float tolerance = 1.0f + in.depth_tolerance, fade = 1.0f / std::max(in.border_px, 1e-6f);
  const float w = static_cast<float>(in.view.reference_width), h = static_cast<float>(in.view.reference_height);
  Projected p;
  float behind[kRun];
  for (int first = 0; first < in.view.width; first += kRun) {
    const int count = std::min(kRun, in.view.width - first);
    const int64_t start = int64_t{row} * in.view.width + first;
    project(in.view, row, first, 1, count, p);
    float* confidence = out.confidence + start;
    float most = 0.0f;
    for (int i = 0; i < count; i++) {
      const float distance = std::min(std::min(p.x[i], w - p.x[i]), std::min(p.y[i], h - p.y[i]));
      confidence[i] = p.inside[i] ? std::min(distance * fade, 1.0f) : 0.0f;
      behind[i] = p.z[i] - occlusion.nearest_depth[p.cell[i]] * tolerance;
      most = std::max(most, behind[i]);
    }
    std::memset(out.occluded + start, 0, count);
    for (int i = 0; most > 0 && i < count; i++) {
      if (behind[i] <= 0 || !hidden(in, row, first + i, behind[i], occlusion.nearest[p.cell[i]])) continue;
      out.occluded[start + i] = 1;
      confidence[i] = 0.0f;
    }
  }
}

void paint(const CagsAlignInput& in, const Padded& reference, int row, float* rgb) {
  Projected p;
  for (int first = 0; first < in.view.width; first += kRun) {
    const int count = std::min(kRun, in.view.width - first);
    project(in.view, row, first, 1, count, p);
    const Taps taps(reference, p, count);
    float* run = rgb + 3 * (int64_t{row} * in.view.width + first);
    for (int i = 0; i < count; i++) put(run, i, count, p.inside[i] ? bilinear(reference, taps[i]) : Four{});
  }
}

void clean(const CagsAlignInput& in, const uint8_t* occluded, const uint8_t* shared, int row, uint8_t* clean) {
  Projected p;
  for (int first = 0; first < in.view.width; first += kRun) {
    const int count = std::min(kRun, in.view.width - first);
    const int64_t start = int64_t{row} * in.view.width + first;
    project(in.view, row, first, 1, count, p);
    for (int i = 0; i < count; i++) clean[first + i] = p.inside[i] & !occluded[start + i] & !shared[p.cell[i]];
  }
}

}  // namespace
}  // namespace cags::align
