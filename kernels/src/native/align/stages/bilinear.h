// Bilinear sampling of padded pictures.
#pragma once
#include "align/stages.h"

#include <algorithm>
#include <cstring>

namespace cags::align {
namespace {

typedef float Four __attribute__((vector_size(16), aligned(4), may_alias));
typedef float Eight __attribute__((vector_size(32), aligned(4), may_alias));

inline float clipped(float value) { return std::min(std::max(value, 0.0f), 1.0f); }

// Where the four taps of a continuous pixel (centres at + 0.5; x in [0, width], y in [0, height]) begin, and their weights.
struct Taps {
  Taps(const Padded& image, float x, float y, int lanes) : stride((image.width + 2) * lanes) {
    const float px = x + 0.5f, py = y + 0.5f;  // in the padded picture, whose pixel (1, 1) is the picture's (0, 0)
    const int ix = static_cast<int>(px), iy = static_cast<int>(py);
    ax = px - static_cast<float>(ix);
    ay = py - static_cast<float>(iy);
    first = image.data + iy * static_cast<int64_t>(stride) + ix * lanes;
  }
  int stride;
  float ax, ay;
  const float* first;
};

inline const Four& four(const float* at) { return *reinterpret_cast<const Four*>(at); }
inline const Eight& eight(const float* at) { return *reinterpret_cast<const Eight*>(at); }

// Pictures of four lanes.
inline Four bilinear(const Padded& image, float x, float y) {
  const Taps t(image, x, y, 4);
  const Eight top = eight(t.first), bottom = eight(t.first + t.stride);  // two neighbours lie side by side
  const Eight both = top + (bottom - top) * t.ay;
  const Four left = __builtin_shufflevector(both, both, 0, 1, 2, 3), right = __builtin_shufflevector(both, both, 4, 5, 6, 7);
  return left + (right - left) * t.ax;
}

}  // namespace
}  // namespace cags::align
