// Bilinear sampling of padded pictures.
#pragma once
#include "align/stages.h"
#include "align/stages/projection.h"

#include <algorithm>
#include <cstring>

namespace cags::align {
namespace {

typedef float Four __attribute__((vector_size(16), aligned(4), may_alias));
typedef float Eight __attribute__((vector_size(32), aligned(4), may_alias));

inline float clipped(float value) { return std::min(std::max(value, 0.0f), 1.0f); }


inline const Four& four(const float* at) { return *reinterpret_cast<const Four*>(at); }
inline const Eight& eight(const float* at) { return *reinterpret_cast<const Eight*>(at); }

// Where the four taps of a continuous pixel (centres at + 0.5; x in [0, width], y in [0, height]) begin in a picture of four
// lanes, and their weights.
struct Tap {
  int32_t first;
  float ax, ay;
};

inline Tap tap_of(const Padded& image, float x, float y) {
  const float px = x + 0.5f, py = y + 0.5f;  // in the padded picture, whose pixel (1, 1) is the picture's (0, 0)
  const int ix = static_cast<int>(px), iy = static_cast<int>(py);
  return {4 * (iy * (image.width + 2) + ix), px - static_cast<float>(ix), py - static_cast<float>(iy)};
}

inline Four bilinear(const Padded& image, const Tap& t) {
  const float* first = image.data + t.first;
  const Eight top = eight(first), bottom = eight(first + 4 * (image.width + 2));  // two neighbours lie side by side
  const Eight both = top + (bottom - top) * t.ay;
  const Four left = __builtin_shufflevector(both, both, 0, 1, 2, 3), right = __builtin_shufflevector(both, both, 4, 5, 6, 7);
  return left + (right - left) * t.ax;
}

inline Four bilinear(const Padded& image, float x, float y) { return bilinear(image, tap_of(image, x, y)); }

// The taps of a run of pixels, worked out a vector at a time.
struct Taps {
  Taps(const Padded& image, const Projected& p, int count) {
    for (int i = 0; i < count; i++) {
      const Tap tap = tap_of(image, p.x[i], p.y[i]);
      first[i] = tap.first, ax[i] = tap.ax, ay[i] = tap.ay;
    }
  }
  Tap operator[](int i) const { return {first[i], ax[i], ay[i]}; }

  int32_t first[kRun];
  float ax[kRun], ay[kRun];
};

// Writes pixel i of a run of three lanes: the fourth float is the next pixel's, which is written next; the last of a run must
// not touch it.
inline void put(float* run, int i, int count, const Four& colour) {
  std::memcpy(run + 3 * i, &colour, i + 1 < count ? sizeof colour : 3 * sizeof(float));
}

// Three floats; the fourth lane is the next pixel's, so the picture's last pixel is read with `whole` false.
inline Four colour_at(const float* at, bool whole) {
  if (whole) return four(at);
  return Four{at[0], at[1], at[2], 0.0f};
}

}  // namespace
}  // namespace cags::align
