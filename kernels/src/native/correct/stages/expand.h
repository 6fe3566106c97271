// What a reference says is lacking, from what was coded.
#pragma once
#include "correct/stages/vector.h"

#include <algorithm>
#include <cmath>

namespace cags::correct {
namespace {

// See cags_common.correction.compander.
constexpr float kZero = 110.0f / 219.0f, kSpan = 109.0f / 219.0f, kStill = 1e-5f;

// 2^x for x in [-126, 126], relative error 2e-7: the minimax polynomial of the rasteriser (raster/stages/exponential.h).
inline Eight exp2(const Eight& x) {
  const Eight magic = all(12582912.0f);  // 1.5 * 2^23: the sum's low mantissa bits are x rounded
  const Eight shifted = x + magic, f = x - (shifted - magic);
  Eight p = f * 0.00133335f + 0.00961813f;
  for (const float c : {0.05550411f, 0.24022651f, 0.69314718f, 1.0f}) p = p * f + c;
  return Eight(EightWords(p) + (EightWords(shifted) << 23));
}

struct Compander {
  float turn, half_knee;  // codes to exponents of 2; half the knee
};

inline Compander compander_of(float knee) {
  const double most = std::asinh(1.0 / knee);
  return {static_cast<float>(most * 1.4426950408889634), knee / 2};
}

inline Eight expanded(const Compander& by, const Eight& coded) {
  const Eight away = coded - kZero;
  const Eight power = exp2(clamped(away * (1.0f / kSpan), -1, 1) * by.turn);
  const EightInts still = (away <= kStill) & (away >= -kStill);
  return keep(~still, (power - 1.0f / power) * by.half_knee);
}

inline EightInts in_units(const Eight& lack) {
  const Eight scaled = clamped(lack, -1, 1) * kUnit;
  const Eight half = select(scaled < 0.0f, all(-0.5f), all(0.5f));
  return __builtin_convertvector(scaled + half, EightInts);
}

inline void put_tap(const int32_t* left, const int32_t* right, int16_t* to) {
  for (int c = 0; c < 3; c++) to[2 * c] = static_cast<int16_t>(left[c]), to[2 * c + 1] = static_cast<int16_t>(right[c]);
  to[6] = to[7] = 0;  // opacity
}

// A row of colours [width, 3], which `made` gives eight values at a time, as taps [width + 1, 4, 2].
template <typename Made>
inline void pack(int width, int16_t* to, const Made& made) {
  constexpr int kChunk = 3 * 32;  // values: whole pixels and whole vectors
  int32_t values[3 + kChunk];     // those of the pixel before come first
  for (int first = 0; first < 3 * width; first += kChunk) {
    const int count = std::min(kChunk, 3 * width - first);
    for (int i = 0; i < count; i += 8) store(values + 3 + i, in_units(made(first + i, std::min(8, count - i))));
    if (first == 0) std::copy_n(values + 3, 3, values);
    for (int i = 0; i < count; i += 3, to += kTap) put_tap(values + i, values + i + 3, to);
    std::copy_n(values + count, 3, values);
  }
  put_tap(values, values, to);
}

inline Eight some(const float* from, int count) {
  if (count == 8) return load(from);
  Eight out = {};
  for (int i = 0; i < count; i++) out[i] = from[i];
  return out;
}

// A row of a layer [width, 4] as taps.
inline void pack_layer(int width, const float* from, int16_t* to) {
  int32_t values[2 * kLanes];  // of a pixel, and of the one to the right
  const auto put = [&](int i, int32_t* at) {
    store(at, in_units(both(from + kLanes * i, from + kLanes * std::min(i + 1, width - 1))));
  };
  for (int i = -1; i < width; i++, to += kTap) {
    put(std::max(i, 0), values);
    const int32_t* right = i < 0 ? values : values + kLanes;
    for (int c = 0; c < kLanes; c++) to[2 * c] = static_cast<int16_t>(values[c]), to[2 * c + 1] = static_cast<int16_t>(right[c]);
  }
}

void expand(const CagsLackInput& in, int row, int16_t* to) {
  const float* coded = in.coded + 3 * int64_t{row} * in.width;
  const Compander by = compander_of(in.knee);
  pack(in.width, to, [=](int i, int count) { return expanded(by, some(coded + i, count)); });
}

}  // namespace
}  // namespace cags::correct
