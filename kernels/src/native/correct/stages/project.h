// Depth of runs of client pixels, and where they lie in the reference.
#pragma once
#include "correct/stages/vector.h"

#include <algorithm>
#include <limits>

namespace cags::correct {
namespace {

// What comes next; past the end of memory it is a hint that nobody follows.
inline void prefetch(const float* from, int count) {
  for (int i = 0; i < count; i += 16) __builtin_prefetch(from + i);
}

// A row of a view in memory, or the rest of one, padded to a run.
struct Pixels {
  // `count` pixels (a run at most) of a row from `first` on.
  Pixels(const CagsAddInput& in, int row, int first, int count) {
    const int64_t start = int64_t{row} * in.width + first;
    alpha = in.alpha + start, depth = in.depth + start;
    prefetch(alpha + kRun, kRun), prefetch(depth + kRun, kRun);
    if (count == kRun) return;
    for (int i = 0; i < kRun; i++) rest[0][i] = i < count ? alpha[i] : 0.0f, rest[1][i] = i < count ? depth[i] : 0.0f;
    alpha = rest[0], depth = rest[1];
  }
  const float *alpha, *depth;

 private:
  float rest[2][kRun];
};

struct Known {
  Eight depth;  // at most kFar
  EightInts is;
};

inline Known known_of(const CagsAddInput& in, const Pixels& pixels, int i) {
  const Eight depth = load(pixels.depth + i);
  const EightInts thin = load(pixels.alpha + i) < all(in.hole_alpha);
  const EightInts is = ~thin & (depth >= all(kLeastDepth)) & (depth <= all(std::numeric_limits<float>::max()));
  return {lesser(depth, all(kFar)), is};
}

// Of eight pixels of a cell, where they lie between its centre and those beside it.
constexpr Eight kBetween = {0.5625f, 0.6875f, 0.8125f, 0.9375f, 0.0625f, 0.1875f, 0.3125f, 0.4375f};

// Depth in the holes of a cell's row. `line` are inverse depths of the cells at this height.
inline Eight around(const float* line, int cell) {
  const Eight before = halves(line[cell - 1], line[cell]), after = halves(line[cell], line[cell + 1]);
  return 1.0f / greater(before + (after - before) * kBetween, all(1.0f / kFar));
}

// Where the row (of `unit` pixels) lies between rows of cells.
struct Between {
  Between(int row, int unit, int rows) {
    const float middle = (static_cast<float>(row) + 0.5f) / static_cast<float>(unit) - 0.5f;
    const float y = std::clamp(middle, 0.0f, static_cast<float>(rows - 1));
    above = static_cast<int>(y), below = std::min(above + 1, rows - 1), share = y - static_cast<float>(above);
  }
  int above, below;
  float share;
};

// `values` [rows, columns] at the height of a row of pixels, with one more on both sides.
inline void line_of(const float* values, int columns, const Between& at, float* __restrict line) {
  const float *top = values + int64_t{at.above} * columns, *low = values + int64_t{at.below} * columns;
  for (int i = 0; i < columns; i++) line[i] = top[i] + (low[i] - top[i]) * at.share;
  line[-1] = line[0], line[columns] = line[columns - 1];
}

// How pixels of one row lie in the reference.
struct Placed {
  Eight x, y;    // the nearest point of the reference; 0 where not ahead
  Eight z;       // 0 where not inside
  Eight beyond;  // reference pixels along the axis on which it lies farther out
  EightInts inside, ahead;
};

inline Eight apart(const Eight& a, const Eight& b) { return greater(a - b, b - a); }

struct Projection {
  Projection(const CagsAddInput& in, int row)
      : right(static_cast<float>(in.reference_width)), bottom(static_cast<float>(in.reference_height)) {
    const float v = static_cast<float>(row) + 0.5f;
    for (int i = 0; i < 3; i++) slope[i] = in.m[3 * i], offset[i] = in.m[3 * i + 1] * v + in.m[3 * i + 2], b[i] = in.b[i];
  }

  // Pixels at `u` (centres) of positive depths; what has none is nowhere.
  Placed operator()(const Eight& u, const Eight& depth) const {
    const Eight z = depth * (slope[2] * u + offset[2]) + b[2], inverse = 1.0f / z;
    const Eight x = (depth * (slope[0] * u + offset[0]) + b[0]) * inverse;
    const Eight y = (depth * (slope[1] * u + offset[1]) + b[1]) * inverse;
    // Comparisons with NaN are false, so that overflowing pixels fall out here.
    const EightInts ahead = (depth > 0.0f) & (z > 0.0f) & (z <= all(std::numeric_limits<float>::max()));
    const EightInts inside = ahead & (x >= 0.0f) & (y >= 0.0f) & (x <= all(right)) & (y <= all(bottom));
    const Eight near_x = keep(ahead, clamped(x, 0, right)), near_y = keep(ahead, clamped(y, 0, bottom));
    return {near_x, near_y, keep(inside, z), greater(apart(x, near_x), apart(y, near_y)), inside, ahead};
  }

  float right, bottom;
  float slope[3], offset[3], b[3];
};

inline EightInts truncated(const Eight& v) { return __builtin_convertvector(v, EightInts); }

}  // namespace
}  // namespace cags::correct
