// Vectors of the variant's width. Written with the compiler's vector extensions, so that every stage is one source for all
// instruction sets; intrinsics only where the extensions have no word for it.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace cags::raster {
namespace {

#if defined(__AVX512F__)
constexpr int kWidth = 16;
#elif defined(__AVX2__)
constexpr int kWidth = 8;
#else
constexpr int kWidth = 4;
#endif

typedef float Floats __attribute__((vector_size(kWidth * sizeof(float))));
typedef uint32_t Words __attribute__((vector_size(kWidth * sizeof(uint32_t))));  // wrap around, where Ints may not
typedef int32_t Ints __attribute__((vector_size(kWidth * sizeof(int32_t))));
typedef double Doubles __attribute__((vector_size(kWidth * sizeof(double))));

inline Floats all(float x) { return Floats{} + x; }
inline Doubles all(double x) { return Doubles{} + x; }

template <typename V = Floats, typename T>
inline V load(const T* p) {
  V v;
  std::memcpy(&v, p, sizeof v);
  return v;
}
template <typename V, typename T>
inline void store(T* p, V v) {
  std::memcpy(p, &v, sizeof v);
}

inline Doubles widen(Floats x) { return __builtin_convertvector(x, Doubles); }
inline Floats narrow(Doubles x) { return __builtin_convertvector(x, Floats); }

// Lanes of `a` where the mask is set (all bits of a lane), of `b` elsewhere.
inline Floats select(Ints mask, Floats a, Floats b) { return Floats((mask & Ints(a)) | (~mask & Ints(b))); }
inline Floats keep(Ints mask, Floats a) { return Floats(mask & Ints(a)); }

// minps / maxps: where either is NaN, the second operand.
inline Floats lesser(Floats a, Floats b) {
#if defined(__AVX512F__)
  return Floats(_mm512_min_ps(__m512(a), __m512(b)));
#elif defined(__AVX2__)
  return Floats(_mm256_min_ps(__m256(a), __m256(b)));
#else
  return select(a < b, a, b);
#endif
}
inline Floats greater(Floats a, Floats b) {
#if defined(__AVX512F__)
  return Floats(_mm512_max_ps(__m512(a), __m512(b)));
#elif defined(__AVX2__)
  return Floats(_mm256_max_ps(__m256(a), __m256(b)));
#else
  return select(a > b, a, b);
#endif
}
inline Floats clamp(Floats x, Floats low, Floats high) { return lesser(greater(x, low), high); }

inline Floats square_root(Floats x) {
#if defined(__AVX512F__)
  return Floats(_mm512_sqrt_ps(__m512(x)));
#elif defined(__AVX2__)
  return Floats(_mm256_sqrt_ps(__m256(x)));
#else
  for (int i = 0; i < kWidth; i++) x[i] = std::sqrt(x[i]);
  return x;
#endif
}

// One bit a lane of a comparison's result.
inline uint32_t bits(Ints mask) {
#if defined(__AVX512F__)
  return _mm512_movepi32_mask(__m512i(mask));
#elif defined(__AVX2__)
  return uint32_t(_mm256_movemask_ps(__m256(mask)));
#else
  uint32_t out = 0;
  for (int i = 0; i < kWidth; i++) out |= uint32_t(mask[i] & 1) << i;
  return out;
#endif
}

// The low byte of each lane.
inline void store_low_bytes(Ints v, uint8_t* out) {
#if defined(__AVX512F__)
  _mm_storeu_si128(reinterpret_cast<__m128i*>(out), _mm512_cvtepi32_epi8(__m512i(v)));
#elif defined(__AVX2__)
  const __m256i first = _mm256_set1_epi32(0x0c080400);  // bytes 0, 4, 8 and 12 of each half
  const __m256i halves = _mm256_shuffle_epi8(__m256i(v), first);
  const __m256i joined = _mm256_permutevar8x32_epi32(halves, _mm256_setr_epi32(0, 4, 0, 4, 0, 4, 0, 4));
  _mm_storel_epi64(reinterpret_cast<__m128i*>(out), _mm256_castsi256_si128(joined));
#else
  for (int i = 0; i < kWidth; i++) out[i] = uint8_t(v[i]);
#endif
}

typedef float Quad __attribute__((vector_size(16)));

inline Quad folded(Floats v) {
  Quad part[kWidth / 4];
  std::memcpy(part, &v, sizeof v);
  Quad total = part[0];
  for (int i = 1; i < kWidth / 4; i++) total += part[i];
  return total;
}

// Past the caches: what lies in them stays there, and no line is read only to be overwritten. To 16 bytes' boundaries; other
// threads see it after `end_streaming`.
inline void stream(float* p, Quad v) {
#if defined(__x86_64__)
  _mm_stream_ps(p, __m128(v));
#else
  std::memcpy(p, &v, sizeof v);
#endif
}
inline void end_streaming() {
#if defined(__x86_64__)
  _mm_sfence();
#endif
}

// Sum of the lanes.
inline float sum(Floats v) {
  const Quad q = folded(v);
  return (q[0] + q[1]) + (q[2] + q[3]);
}

}  // namespace
}  // namespace cags::raster
