// Bilinear sampling of a padded picture with one vector load a tap.
#pragma once
#include "align/stages.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace cags::align {
namespace {

template <int lanes>
struct Vector {
  typedef float type __attribute__((vector_size(lanes * sizeof(float)), aligned(4), may_alias));
};
template <int lanes>
using Lanes = typename Vector<lanes>::type;

// The value at continuous pixel (x, y), centres at + 0.5; x in [0, width], y in [0, height].
template <int lanes>
inline Lanes<lanes> bilinear(const Padded& image, float x, float y) {
  const float px = x + 0.5f, py = y + 0.5f;  // in the padded picture, whose pixel (1, 1) is the picture's (0, 0)
  const int ix = static_cast<int>(px), iy = static_cast<int>(py);
  const float ax = px - static_cast<float>(ix), ay = py - static_cast<float>(iy);
  const int stride = (image.width + 2) * lanes;
  const float* tap = image.data + iy * static_cast<int64_t>(stride) + ix * lanes;
  const auto& v00 = *reinterpret_cast<const Lanes<lanes>*>(tap);
  const auto& v01 = *reinterpret_cast<const Lanes<lanes>*>(tap + lanes);
  const auto& v10 = *reinterpret_cast<const Lanes<lanes>*>(tap + stride);
  const auto& v11 = *reinterpret_cast<const Lanes<lanes>*>(tap + stride + lanes);
  const Lanes<lanes> top = v00 + (v01 - v00) * ax, bottom = v10 + (v11 - v10) * ax;
  return top + (bottom - top) * ay;
}

}  // namespace
}  // namespace cags::align
