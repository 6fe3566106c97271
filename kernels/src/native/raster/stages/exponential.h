// exp2 and log2 of vectors, to the accuracy of each level of exactness.
#pragma once
#include "raster/stages/vector.h"

namespace cags::raster {
namespace {

// Coefficients, highest first, of minimax polynomials for 2^x on [-1/2, 1/2]: relative error 1e-4 and 2e-7.
template <int kDegree>
inline constexpr float kExp2[kDegree + 1] = {};
template <>
inline constexpr float kExp2<3>[4] = {0.0558008f, 0.2401397f, 0.6931475f, 0.9999993f};
template <>
inline constexpr float kExp2<5>[6] = {0.00133335f, 0.00961813f, 0.05550411f, 0.24022651f, 0.69314718f, 1.0f};

// out = 2^x for x in [-126, 126]; outside, garbage that the caller must mask. Each operation goes through all vectors before
// the next: compilers keep that order, and it is what keeps several units busy.
template <int kDegree, int kCount>
inline void exp2(const Floats (&x)[kCount], Floats (&out)[kCount]) {
  const Floats magic = all(12582912.0f);  // 1.5 * 2^23: the sum's low mantissa bits are x rounded
  Floats shifted[kCount], f[kCount], p[kCount];
  for (int i = 0; i < kCount; i++) shifted[i] = x[i] + magic;
  for (int i = 0; i < kCount; i++) f[i] = x[i] - (shifted[i] - magic);
  for (int i = 0; i < kCount; i++) p[i] = f[i] * kExp2<kDegree>[0] + kExp2<kDegree>[1];
  for (int degree = 2; degree <= kDegree; degree++)
    for (int i = 0; i < kCount; i++) p[i] = p[i] * f[i] + kExp2<kDegree>[degree];
  for (int i = 0; i < kCount; i++) out[i] = Floats(Words(p[i]) + (Words(shifted[i]) << 23));
}

// log2 of a positive normal number, to float32 rounding: atanh's series about a mantissa in [sqrt(1/2), sqrt(2)).
inline Floats log2(Floats x) {
  const Ints half_root = Ints{} + 0x3f3504f3;
  const Ints exponent = (Ints(x) - half_root) >> 23;
  const Floats mantissa = Floats(Words(x) - (Words(exponent) << 23));
  const Floats t = (mantissa - 1.0f) / (mantissa + 1.0f), t2 = t * t;
  Floats p = all(1.0f / 9) * t2 + 1.0f / 7;
  p = p * t2 + 1.0f / 5;
  p = p * t2 + 1.0f / 3;
  p = p * t2 + 1.0f;
  return p * t * 2.88539008f + __builtin_convertvector(exponent, Floats);
}

}  // namespace
}  // namespace cags::raster
