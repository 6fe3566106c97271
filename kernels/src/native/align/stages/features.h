// What a small network sees of a frame at half resolution, and its answer added to the picture.
#pragma once
#include "align/stages/bilinear.h"
#include "align/stages/projection.h"

namespace cags::align {
namespace {

// Mean of 2 x 2 pixels that lie side by side.
inline Four mean_colour(const float* top, const float* bottom) {
  return 0.25f * (four(top) + four(top + 3) + four(bottom) + four(bottom + 3));
}

// The same near the edges, which repeat, and at the picture's end.
Four edge_colour(const CagsReprojection& view, const float* picture, int y, int x) {
  Four sum = {};
  for (int j = 0; j < 2; j++) {
    for (int i = 0; i < 2; i++) {
      const int row = std::min(y + j, view.height - 1), column = std::min(x + i, view.width - 1);
      sum += colour_at(picture + 3 * (int64_t{row} * view.width + column), false);
    }
  }
  return 0.25f * sum;
}

inline float sum_of(const Four& v) { return v[0] + v[1] + v[2]; }

// One cell: nine lanes to `out`; adds its confidence and the size of its change to `sums`.
inline void feature_cell(const CagsFeaturesInput& in, const Padded& evidence, int y, int x, float rx, float ry, float* out,
                         float* sums) {
  const CagsReprojection& view = in.view;
  const int64_t pixel = int64_t{y} * view.width + x, below = pixel + view.width;
  const bool inner = x + 2 < view.width && y + 1 < view.height;
  Four distorted, change, found = {};
  float confidence = 0.0f;
  bool sure = false;
  if (inner) {
    distorted = mean_colour(in.distorted + 3 * pixel, in.distorted + 3 * below);
    change = mean_colour(in.restored + 3 * pixel, in.restored + 3 * below) - distorted;
    const float* c = in.confidence;
    confidence = 0.25f * (c[pixel] + c[pixel + 1] + c[below] + c[below + 1]);
    sure = c[pixel] > 0;
  } else {
    const int row = std::min(y, view.height - 1), column = std::min(x, view.width - 1);
    distorted = edge_colour(view, in.distorted, row, column);
    change = edge_colour(view, in.restored, row, column) - distorted;
    for (int j = y; j < std::min(y + 2, view.height); j++) {
      for (int i = x; i < std::min(x + 2, view.width); i++) confidence += 0.25f * in.confidence[int64_t{j} * view.width + i];
    }
    sure = y < view.height && x < view.width && in.confidence[pixel] > 0;
  }
  if (sure) found = bilinear(evidence, rx, ry);
  std::memcpy(out, &distorted, 3 * sizeof(float));
  std::memcpy(out + 3, &found, 3 * sizeof(float));
  std::memcpy(out + 6, &change, 3 * sizeof(float));
  sums[0] += confidence;
  sums[1] += sum_of(change < Four{} ? -change : change);
}

// One row of cells into the lower or upper half of its row of blocks.
void feature_row(const CagsFeaturesInput& in, const Padded& evidence, int row, float* out) {
  const CagsReprojection& view = in.view;
  const int y = 2 * row, cells = 2 * blocks(view.width), seen = (view.width + 1) / 2;
  Projected p;
  for (int first = 0; first < cells; first += kRun) {
    const int count = std::min(kRun, cells - first);
    if (first < seen) project(view, std::min(y, view.height - 1), 2 * first, 2, std::min(count, seen - first), p);
    for (int i = 0; i < count; i++) {
      const int cell = first + i;
      float* block = out + (cell / 2) * kBlockLanes;
      float* at = block + (2 * (row % 2) + cell % 2) * kCellLanes;
      feature_cell(in, evidence, y, 2 * cell, p.x[i], p.y[i], at, block + 4 * kCellLanes);
    }
  }
}

void features(const CagsFeaturesInput& in, const Padded& evidence, int row, float* out) {
  const int count = blocks(in.view.width);
  for (int i = 0; i < count; i++) std::fill_n(out + i * kBlockLanes + 4 * kCellLanes, 3, 0.0f);
  feature_row(in, evidence, 2 * row, out);
  feature_row(in, evidence, 2 * row + 1, out);
  for (int i = 0; i < count; i++) {
    out[i * kBlockLanes + 4 * kCellLanes] *= 1.0f / 4.0f;
    out[i * kBlockLanes + 4 * kCellLanes + 1] *= 1.0f / 12.0f;
  }
}

// Weights of a row's or column's two nearest cells of half the resolution: the near one has three quarters.
inline int other_cell(int pixel, int cells) { return std::clamp(pixel / 2 + (pixel % 2 ? 1 : -1), 0, cells - 1); }

void add(const CagsAddInput& in, int row, float* line, float* out) {
  const int cells = 2 * in.change_width, near_row = row / 2, far_row = other_cell(row, 2 * in.change_height);
  const auto six = [&](int cell_row, int block) {  // the two cells of a block that lie in this row
    return in.change + (int64_t{cell_row / 2} * in.change_width + block) * 12 + (cell_row % 2) * 6;
  };
  for (int block = 0; block < in.change_width; block++) {
    const float* near = six(near_row, block);
    const float* far = six(far_row, block);
    for (int i = 0; i < 6; i++) line[6 * block + i] = 0.75f * near[i] + 0.25f * far[i];
  }
  const int64_t start = int64_t{row} * in.width * 3;
  const float* picture = in.picture + start;
  out += start;
  for (int x = 0; x < in.width; x++) {
    const float* a = line + 3 * (x / 2);
    const float* b = line + 3 * other_cell(x, cells);
    for (int c = 0; c < 3; c++) {
      const float shown = picture[3 * x + c] + (0.75f * a[c] + 0.25f * b[c]);
      out[3 * x + c] = std::min(std::max(shown, 0.0f), 1.0f);
    }
  }
}

}  // namespace
}  // namespace cags::align
