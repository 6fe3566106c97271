// The layers of the network: blocks of pixels in, features through the body, changes to the fields out.
#pragma once
#include "lite/stages/winograd.h"
#include "raster/stages/exponential.h"

#include <cmath>

namespace cags::lite {
namespace {

// See cags_client.restore.networks.lite.
constexpr float kSlope = 0.1f, kFaint = 8.0f, kGateHalf = 5e-4f;
constexpr int kGateReach = 2;  // cells to each side
constexpr int kBlock = 2;
constexpr int kInputs = kBlock * kBlock * kSeen;

inline Lanes leaky(Lanes x) {
#if defined(__AVX2__)
  return Lanes(_mm256_max_ps(__m256(x), __m256(x * kSlope)));
#else
  for (int i = 0; i < kLanes; i++) x[i] = std::max(x[i], x[i] * kSlope);
  return x;
#endif
}

// What the network sees of a block: its four pixels in reading order. Returns the mean size of the correction.
inline float see(const CagsLiteInput& in, int row, int column, float* __restrict seen) {
  float size = 0;
  for (int pixel = 0; pixel < kBlock * kBlock; pixel++, seen += kSeen) {
    const size_t place = size_t(kBlock * row + pixel / kBlock) * in.width + kBlock * column + pixel % kBlock;
    const float *own = in.own + 3 * place, *reference = in.reference + 3 * place, *field = in.fields + kFieldLanes * place;
    for (int c = 0; c < 3; c++) {
      const float correction = own[c] * field[0] + field[1 + c];
      seen[c] = own[c], seen[3 + c] = kFaint * (reference[c] - own[c]), seen[6 + c] = kFaint * correction;
      size += std::abs(correction);
    }
    seen[9] = field[0];
  }
  return size / (3 * kBlock * kBlock);
}

void head(const CagsLiteInput& in, int row, const Plane& to, float* power) {
  constexpr int kVectors = kWidth / kLanes;
  float seen[kGroup][kInputs] = {};
  for (int first = 0; first < to.columns; first += kGroup) {
    const int count = std::min(kGroup, to.columns - first);
    for (int t = 0; t < count; t++) power[size_t(row) * to.columns + first + t] = see(in, row, first + t, seen[t]);
    Lanes sums[kGroup][kVectors];
    for (int t = 0; t < kGroup; t++)
      for (int v = 0; v < kVectors; v++) sums[t][v] = get(in.head_bias + v * kLanes);
    for (int i = 0; i < kInputs; i++) {
      Lanes column[kVectors];
      for (int v = 0; v < kVectors; v++) column[v] = get(in.head + i * kWidth + v * kLanes);
      for (int t = 0; t < kGroup; t++)
        for (int v = 0; v < kVectors; v++) sums[t][v] += column[v] * seen[t][i];
    }
    for (int t = 0; t < count; t++)
      for (int v = 0; v < kVectors; v++) put(to.at(row, first + t) + v * kLanes, leaky(sums[t][v]));
  }
}

template <bool kAdds>
inline void convolve_row(const Plane& from, const Layer& layer, int tile_row, const Plane& to, float* run) {
  const size_t stride = to.stride();
  const float* bias = layer.bias;
  convolve_tiles<kWidth>(from, layer.weights, tile_row, run, [&](int rows, int columns, int column, const auto& give) {
    float* corner = to.at(kTile * tile_row, column);
    give([=](int y, int x, int channel, Lanes value) {
      if (y >= rows || x >= columns) return;
      float* out = corner + y * stride + x * kWidth + channel;
      value = leaky(value + get(bias + channel));
      put(out, kAdds ? get(out) + value : value);
    });
  });
}

void convolve(const Plane& from, const Layer& layer, int tile_row, const Plane& to, float* run) {
  if (layer.adds) {
    convolve_row<true>(from, layer, tile_row, to, run);
  } else {
    convolve_row<false>(from, layer, tile_row, to, run);
  }
}

// How far the network may go in a row [columns], in [0, 1): by the mean size of the correction nearby. `sums` [columns] is
// scratch.
inline void gate(const Plane& plane, const float* power, int row, float* sums, float* open) {
  const int top = std::max(row - kGateReach, 0), bottom = std::min(row + kGateReach, plane.rows - 1), columns = plane.columns;
  std::fill_n(sums, columns, 0.0f);
  for (int y = top; y <= bottom; y++)
    for (int x = 0; x < columns; x++) sums[x] += power[size_t(y) * columns + x];
  for (int x = 0; x < columns; x++) {
    const int left = std::max(x - kGateReach, 0), right = std::min(x + kGateReach, columns - 1);
    float sum = 0;
    for (int i = left; i <= right; i++) sum += sums[i];
    const float near = sum / static_cast<float>((bottom - top + 1) * (right - left + 1));
    open[x] = near / (near + kGateHalf);
  }
}

// change = bound tanh(change / bound), lane by lane; `count` is a multiple of the vectors' width.
inline void bounded(float* change, size_t count, const float (&bound)[kFieldLanes], const float (&scale)[kFieldLanes]) {
  using namespace raster;
  Floats most, turn;
  for (int i = 0; i < raster::kWidth; i++) {
    most[i] = bound[i % kFieldLanes];
    turn[i] = 2.8853900817779268f * scale[i % kFieldLanes] / bound[i % kFieldLanes];  // 2 / ln 2: e^2x as a power of 2
  }
  for (size_t i = 0; i < count; i += raster::kWidth) {
    const Floats exponent[1] = {clamp(load(change + i) * turn, all(-40.0f), all(40.0f))};
    Floats power[1];
    exp2<5>(exponent, power);
    store(change + i, most * (1.0f - 2.0f / (power[0] + 1.0f)));
  }
}

inline void apply(const CagsLiteInput& in, int y, const float* change, float* improved) {
  const size_t start = size_t(y) * in.width;
  const float *own = in.own + 3 * start, *field = in.fields + kFieldLanes * start;
  float* out = improved + kFieldLanes * start;
  for (int x = 0; x < in.width; x++, own += 3, field += kFieldLanes, out += kFieldLanes, change += kFieldLanes) {
    out[0] = field[0] + change[0];
    for (int c = 0; c < 3; c++) out[1 + c] = field[1 + c] + change[1 + c] - change[0] * own[c];
  }
}

// What the network answers for a row of tiles: its pixels in rows of the picture, `line` floats apart.
inline void answer(const CagsLiteInput& in, const Plane& from, int tile_row, float* lines, size_t line, float* run) {
  constexpr int kLine = kBlock * kFieldLanes;  // of a block's pixels in one row of the picture
  const float* bias = in.tail_bias;
  convolve_tiles<kAnswer>(from, in.tail, tile_row, run, [&](int, int columns, int column, const auto& give) {
    float* corner = lines + size_t(column) * kLine;
    give([=](int y, int x, int channel, Lanes value) {
      if (x >= columns) return;
      put(corner + (kBlock * y + channel / kLine) * line + x * kLine + channel % kLine, value + get(bias + channel));
    });
  });
}

void tail(const CagsLiteInput& in, const Plane& from, int tile_row, const Ending& to, float* run) {
  constexpr int kLine = kBlock * kFieldLanes;
  const size_t line = ending_line(from.columns);
  answer(in, from, tile_row, to.lines, line, run);
  float *open = to.lines + kEndingLines * line, *sums = open + line / 2;
  const float bound[kFieldLanes] = {in.factor_reach, in.colour_reach, in.colour_reach, in.colour_reach};
  const float scale[kFieldLanes] = {1.0f, 1.0f / kFaint, 1.0f / kFaint, 1.0f / kFaint};
  for (int y = 0; y < kTile && kTile * tile_row + y < from.rows; y++) {
    gate(from, to.power, kTile * tile_row + y, sums, open);
    const int first = kBlock * (kTile * tile_row + y);
    for (int r = 0; r < kBlock; r++) {
      float* change = to.lines + (kBlock * y + r) * line;
      for (int column = 0; column < from.columns; column++)
        for (int i = 0; i < kLine; i++) change[column * kLine + i] *= open[column];
      bounded(change, line, bound, scale);
      apply(in, first + r, change, to.improved);
    }
  }
}

}  // namespace
}  // namespace cags::lite
