// Bilinear sampling of padded pictures.
#pragma once
#include "align/stages.h"
#include "align/stages/projection.h"

#include <algorithm>
#include <cstring>
#if defined(__AVX2__)
#include <immintrin.h>
#endif

namespace cags::align {
namespace {

typedef float Four __attribute__((vector_size(16), aligned(4), may_alias));
typedef float Eight __attribute__((vector_size(32), aligned(4), may_alias));
typedef int32_t EightInts __attribute__((vector_size(32)));

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

// The two neighbours left and right of a tap, which lie side by side, at its height.
inline Eight beside(const Padded& image, const Tap& t) {
  const float* first = image.data + t.first;
  const Eight top = eight(first), bottom = eight(first + 4 * (image.width + 2));
  return top + (bottom - top) * t.ay;
}

inline Four bilinear(const Padded& image, const Tap& t) {
  const Eight both = beside(image, t);
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

// One value for each half.
inline Eight halves(float low, float high) { return Eight{low, low, low, low, high, high, high, high}; }
inline Eight halves(const Four& low, const Four& high) {
  return __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7);
}

// Two pixels' samples, one in each half.
inline Eight bilinear(const Padded& image, const Tap& one, const Tap& two) {
  const Eight a = beside(image, one), b = beside(image, two);
  const Eight left = __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11);
  const Eight right = __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
  return left + (right - left) * halves(one.ax, two.ax);
}

// Each lane in [0, 1]; NaN becomes 0.
inline Eight clipped(const Eight& v) {
#if defined(__AVX2__)
  const __m256 zero = _mm256_setzero_ps(), one = _mm256_set1_ps(1.0f);
  return Eight(_mm256_min_ps(_mm256_max_ps(__m256(v), zero), one));
#else
  const Eight zero = {}, one = zero + 1.0f, low = v > zero ? v : zero;
  return low < one ? low : one;
#endif
}

// table[index] of eight indices from 0 to 7.
inline Eight looked_up(const float* table, const EightInts& index) {
#if defined(__AVX2__)
  return Eight(_mm256_permutevar8x32_ps(_mm256_loadu_ps(table), __m256i(index)));
#else
  Eight out;
  for (int i = 0; i < 8; i++) out[i] = table[index[i]];
  return out;
#endif
}

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
