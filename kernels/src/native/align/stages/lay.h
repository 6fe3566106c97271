// One picture laid over part of another.
#pragma once
#include "align/stages/bilinear.h"

namespace cags::align {
namespace {

// Eight pixels are three vectors of colours; where nothing is laid over them they are not touched.
inline void lay_eight(const Eight& weight, const float* over, float* shown) {
  constexpr EightInts kPixels[3] = {{0, 0, 0, 1, 1, 1, 2, 2}, {2, 3, 3, 3, 4, 4, 4, 5}, {5, 5, 6, 6, 6, 7, 7, 7}};
  float weights[8];
  std::memcpy(weights, &weight, sizeof weights);
  for (int i = 0; i < 3; i++) {
    const Eight before = eight(shown + 8 * i);
    const Eight after = before + (eight(over + 8 * i) - before) * looked_up(weights, kPixels[i]);
    std::memcpy(shown + 8 * i, &after, sizeof after);
  }
}

void lay(const CagsLayInput& in, int row, float* shown) {
  const float* share = in.share + row * in.share_pitch;
  const float* confidence = in.confidence + int64_t{row} * in.width;
  const float* over = in.over + 3 * int64_t{row} * in.width;
  int i = 0;
  for (; i + 8 <= in.width; i += 8) {
    const Eight weight = eight(share + i) * eight(confidence + i);
    const Eight zero = {};
    const EightInts some = weight != zero;
    int32_t any = 0;
    for (int k = 0; k < 8; k++) any |= some[k];
    if (any) lay_eight(weight, over + 3 * i, shown + 3 * i);
  }
  for (; i < in.width; i++) {
    const float weight = share[i] * confidence[i];
    for (int c = 0; c < 3; c++) shown[3 * i + c] += weight * (over[3 * i + c] - shown[3 * i + c]);
  }
}

}  // namespace
}  // namespace cags::align
