// Eight pixels at a time, whatever the instruction set: a row of a cell.
#pragma once
#include "correct/stages.h"

#include <cstring>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace cags::correct {
namespace {

typedef float Four __attribute__((vector_size(16)));
typedef float Eight __attribute__((vector_size(32)));
typedef int32_t EightInts __attribute__((vector_size(32)));
typedef uint32_t EightWords __attribute__((vector_size(32)));  // wrap around, where EightInts may not

constexpr Eight kSteps = {0, 1, 2, 3, 4, 5, 6, 7};

inline Eight all(float x) { return Eight{} + x; }

template <typename V = Eight, typename T>
inline V load(const T* from) {
  V v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
template <typename V, typename T>
inline void store(T* to, const V& v) {
  std::memcpy(to, &v, sizeof v);
}

// Lanes of `a` where the mask is set (all bits of a lane), of `b` elsewhere.
inline Eight select(const EightInts& mask, const Eight& a, const Eight& b) {
  return Eight((mask & EightInts(a)) | (~mask & EightInts(b)));
}
inline Eight keep(const EightInts& mask, const Eight& a) { return Eight(mask & EightInts(a)); }

// Where either is NaN, the second operand.
inline Eight lesser(const Eight& a, const Eight& b) {
#if defined(__AVX2__)
  return Eight(_mm256_min_ps(__m256(a), __m256(b)));
#else
  return select(a < b, a, b);
#endif
}
inline Eight greater(const Eight& a, const Eight& b) {
#if defined(__AVX2__)
  return Eight(_mm256_max_ps(__m256(a), __m256(b)));
#else
  return select(a > b, a, b);
#endif
}
inline Eight clamped(const Eight& x, float low, float high) { return lesser(greater(x, all(low)), all(high)); }

// One bit a lane of a comparison's result.
inline uint32_t bits(const EightInts& mask) {
#if defined(__AVX2__)
  return uint32_t(_mm256_movemask_ps(__m256(mask)));
#else
  uint32_t out = 0;
  for (int i = 0; i < 8; i++) out |= uint32_t(mask[i] & 1) << i;
  return out;
#endif
}

template <int kHigh>
inline Four half(const Eight& v) {
  return __builtin_shufflevector(v, v, 4 * kHigh, 4 * kHigh + 1, 4 * kHigh + 2, 4 * kHigh + 3);
}

// Four floats from each place.
inline Eight both(const float* low, const float* high) {
  return __builtin_shufflevector(load<Four>(low), load<Four>(high), 0, 1, 2, 3, 4, 5, 6, 7);
}

inline float sum(const Eight& v) {
  const Four q = half<0>(v) + half<1>(v);
  return (q[0] + q[1]) + (q[2] + q[3]);
}

// One value for each half.
inline Eight halves(float low, float high) {
#if defined(__AVX2__)
  return Eight(_mm256_blend_ps(_mm256_set1_ps(low), _mm256_set1_ps(high), 0xf0));
#else
  return Eight{low, low, low, low, high, high, high, high};
#endif
}

}  // namespace
}  // namespace cags::correct
