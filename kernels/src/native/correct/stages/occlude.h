// What is nearest in each reference pixel.
#pragma once
#include "correct/stages/project.h"

#include <bit>

namespace cags::correct {
namespace {

// Depths of eight pixels from the `first` on that are looked at; lines are padded by zeros to whole runs.
template <int kStride>
inline Eight every(const float* line, int first, int stride, int count) {
  if constexpr (kStride == 1) return load(line + first);
  if constexpr (kStride == 2)
    return __builtin_shufflevector(load(line + 2 * first), load(line + 2 * first + kCell), 0, 2, 4, 6, 8, 10, 12, 14);
  Eight depth = {};
  for (int i = 0; i < std::min(kCell, count - first); i++) depth[i] = line[(first + i) * stride];
  return depth;
}

// The pixels of `line` [width] that are looked at (every stride-th; a depth of 0 is none) claim the reference pixels that
// they lie in.
template <int kStride>
inline void claim(const CagsAddInput& in, int row, const float* line, Nearest* nearest) {
  const int stride = kStride ? kStride : in.stride, across = in.reference_width + 1;
  const int count = (in.width + stride - 1) / stride, nowhere = across * (in.reference_height + 1);
  const Projection project(in, row);
  const uint32_t place = static_cast<uint32_t>(row) << 16;
  uint32_t z[kCell], cell[kCell];
  for (int first = 0; first < count; first += kCell) {
    const Eight depth = every<kStride>(line, first, stride, count);
    const Placed p = project((kSteps + static_cast<float>(first)) * static_cast<float>(stride) + 0.5f, depth);
    if (!bits(p.inside)) continue;
    const EightInts at = truncated(p.y) * across + truncated(p.x);
    store(cell, (p.inside & at) | (~p.inside & nowhere));  // one more that nobody looks at
    store(z, p.z);
    for (int i = 0; i < kCell; i++) {
      const Nearest mine = (Nearest{z[i]} << 32) | (place + static_cast<uint32_t>((first + i) * stride));
      nearest[cell[i]] = std::min(nearest[cell[i]], mine);
    }
  }
}

inline void claim_row(const CagsAddInput& in, int row, const float* line, Nearest* nearest) {
  switch (in.stride) {
    case 1: return claim<1>(in, row, line, nearest);
    case 2: return claim<2>(in, row, line, nearest);
    default: return claim<0>(in, row, line, nearest);
  }
}

inline int rows_of(const CagsAddInput& in, int cell_row) { return std::min(kCell, in.height - cell_row * kCell); }

// Adds one row of pixels to the sums of its cells; `known` are their depths, 0 in holes.
inline void survey_row(const CagsAddInput& in, int row, const Line& line, float* known_depth) {
  for (int first = 0; first < in.width; first += kRun) {
    const Pixels pixels(in, row, first, std::min(kRun, in.width - first));
    for (int i = 0; i < kRun; i += kCell) {
      const Known known = known_of(in, pixels, i);
      const int at = first + i;
      store(known_depth + at, keep(known.is, known.depth));
      store(line.sums + at, load(line.sums + at) + keep(known.is, 1.0f / known.depth));
      store(line.counts + at, load(line.counts + at) + keep(known.is, all(1.0f)));
    }
  }
}

// Means of a row of cells from their sums. Returns whether there are holes.
inline bool average(const CagsAddInput& in, int cell_row, const Line& line, const Cells& cells) {
  const int rows = rows_of(in, cell_row);
  bool holes = false;
  float *inverse = cells.inverse + int64_t{cell_row} * cells.columns, *weight = cells.weight + int64_t{cell_row} * cells.columns;
  for (int i = 0; i < cells.columns; i++) {
    const float known = sum(load(line.counts + i * kCell)),
                most = static_cast<float>(rows * std::min(kCell, in.width - i * kCell));
    inverse[i] = sum(load(line.sums + i * kCell)) / std::max(known, 1e-6f);
    weight[i] = known / most;
    holes |= known < most;
  }
  return holes;
}

bool survey(const CagsAddInput& in, int cell_row, const Line& line, const Cells& cells, const Depths& depths, Nearest* nearest) {
  const int rows = rows_of(in, cell_row), top = cell_row * kCell;
  std::fill_n(line.sums, line.part, 0.0f);
  std::fill_n(line.counts, line.part, 0.0f);
  for (int r = 0; r < rows; r++) {
    survey_row(in, top + r, line, line.row(r));
    if ((top + r) % in.stride == 0) claim_row(in, top + r, line.row(r), nearest);
  }
  const bool holes = average(in, cell_row, line, cells);
  for (int r = 0; r < rows; r++) {
    float* filled = depths.filled + (top + r) * depths.pitch;
    if (holes) std::copy_n(line.row(r), depths.pitch, filled);
    depths.rows[top + r] = holes ? filled : in.depth + int64_t{top + r} * in.width;
  }
  return holes;
}

void patch(const CagsAddInput& in, int cell_row, const Line& line, const Cells& cells, const Depths& depths, Nearest* nearest) {
  float* patched = line.depth;  // what is filled in a row, and zeros
  for (int r = 0; r < rows_of(in, cell_row); r++) {
    const int row = cell_row * kCell + r;
    float* depth = depths.filled + row * depths.pitch;
    line_of(cells.inverse, cells.columns, Between(row, kCell, cells.rows), line.around);
    bool any = false;
    for (int i = 0; i < in.width; i += kCell) {
      const Eight known = load(depth + i);
      EightInts hole = known == 0.0f;
      Eight here = {};
      if (bits(hole)) {
        if (in.width - i < kCell) hole &= kSteps < static_cast<float>(in.width - i);
        here = keep(hole, around(line.around, i / kCell));
        store(depth + i, select(hole, here, known));
        any = true;
      }
      store(patched + i, here);
    }
    if (!any || row % in.stride) continue;
    std::fill_n(patched + rounded_up(in.width, kCell), depths.pitch - rounded_up(in.width, kCell), 0.0f);
    claim_row(in, row, patched, nearest);
  }
}

}  // namespace
}  // namespace cags::correct
