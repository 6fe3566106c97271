// exp2 and log2 of vectors, to the accuracy of each level of exactness.
#pragma once
#include "raster/stages/vector.h"

namespace cags::raster {
namespace {

// 2^x for x in [-126, 126]; outside, garbage that the caller must mask. Minimax polynomials on [-1/2, 1/2]: relative error
// 1e-4, 4e-6 and 2e-7 for degrees 3, 4 and 5.
template <int kDegree>
inline Floats exp2(Floats x) {
  const Floats magic = all(12582912.0f);  // 1.5 * 2^23: the sum's low mantissa bits are x rounded
  const Floats shifted = x + magic, f = x - (shifted - magic);
  Floats p;
  if constexpr (kDegree == 3) {
    p = all(0.0558008f) * f + 0.2401397f;
    p = p * f + 0.6931475f;
    p = p * f + 0.9999993f;
  } else if constexpr (kDegree == 4) {
    p = all(0.0096181f) * f + 0.0555042f;
    p = p * f + 0.2402265f;
    p = p * f + 0.6931472f;
    p = p * f + 1.0f;
  } else {
    p = all(0.00133335f) * f + 0.00961813f;
    p = p * f + 0.05550411f;
    p = p * f + 0.24022651f;
    p = p * f + 0.69314718f;
    p = p * f + 1.0f;
  }
  return Floats(Words(p) + (Words(shifted) << 23));
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
