// 3x3 convolutions by Winograd's minimal filtering F(4x4, 3x3) (Lavin and Gray 2016): a tile of 4x4 outputs takes 36
// multiplications a pair of channels instead of 144. Inputs and outputs are transformed with the points 0, +-1, +-2 and infinity.
#pragma once
#include "lite/stages.h"

#include <algorithm>
#include <cstring>

namespace cags::lite {
namespace {

#if defined(__AVX2__)
constexpr int kLanes = 8, kGroup = 4;  // tiles multiplied at once: 12 sums, 3 weights and an input fill 16 registers
#else
constexpr int kLanes = 4, kGroup = 2;
#endif

typedef float Lanes __attribute__((vector_size(kLanes * sizeof(float))));

inline Lanes get(const float* from) {
  Lanes v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline void put(float* to, Lanes v) { std::memcpy(to, &v, sizeof v); }

inline void to_domain(const Lanes (&d)[kSpan], Lanes (&out)[kSpan]) {
  const Lanes even = d[4] - 4.0f * d[2], odd = d[3] - 4.0f * d[1], across = d[4] - d[2], along = 2.0f * (d[3] - d[1]);
  out[0] = 4.0f * d[0] - 5.0f * d[2] + d[4];
  out[1] = even + odd;
  out[2] = even - odd;
  out[3] = across + along;
  out[4] = across - along;
  out[5] = 4.0f * d[1] - 5.0f * d[3] + d[5];
}

inline void from_domain(const Lanes (&m)[kSpan], Lanes (&out)[kTile]) {
  const Lanes near = m[1] + m[2], far = m[3] + m[4], slope = m[1] - m[2], steep = m[3] - m[4];
  out[0] = m[0] + near + far;
  out[1] = slope + 2.0f * steep;
  out[2] = near + 4.0f * far;
  out[3] = slope + 8.0f * steep + m[5];
}

// run[place][tile] = the inputs of a tile in Winograd's domain.
inline void take_tile(const Plane& from, int tile_row, int tile_column, int tile, float* run) {
  const size_t stride = from.stride();
  const float* corner = from.data + kTile * (tile_row * stride + size_t(tile_column) * kWidth);
  for (int channel = 0; channel < kWidth; channel += kLanes) {
    Lanes half[kSpan][kSpan];
    for (int x = 0; x < kSpan; x++) {
      Lanes column[kSpan], out[kSpan];
      for (int y = 0; y < kSpan; y++) column[y] = get(corner + y * stride + x * kWidth + channel);
      to_domain(column, out);
      for (int y = 0; y < kSpan; y++) half[y][x] = out[y];
    }
    for (int y = 0; y < kSpan; y++) {
      Lanes out[kSpan];
      to_domain(half[y], out);
      for (int x = 0; x < kSpan; x++) put(run + (size_t(y * kSpan + x) * kRun + tile) * kWidth + channel, out[x]);
    }
  }
}

// For each place: [tiles, kWidth] x [kWidth, kOut], in place; rows stay kWidth apart.
template <int kOut>
inline void multiply(const float* weights, int tiles, float* run) {
  constexpr int kVectors = kOut / kLanes;
  for (int place = 0; place < kPlaces; place++) {
    const float* w = weights + size_t(place) * kWidth * kOut;
    for (int first = 0; first < tiles; first += kGroup) {
      float* rows = run + (size_t(place) * kRun + first) * kWidth;
      Lanes sums[kGroup][kVectors] = {};
      for (int in = 0; in < kWidth; in++) {
        Lanes column[kVectors];
        for (int v = 0; v < kVectors; v++) column[v] = get(w + in * kOut + v * kLanes);
        for (int t = 0; t < kGroup; t++)
          for (int v = 0; v < kVectors; v++) sums[t][v] += column[v] * rows[t * kWidth + in];
      }
      for (int t = 0; t < kGroup; t++)
        for (int v = 0; v < kVectors; v++) put(rows + t * kWidth + v * kLanes, sums[t][v]);
    }
  }
}

// Calls put_pixel(y, x, channel, value) for the outputs of a tile.
template <int kOut, typename PutPixel>
inline void give_tile(const float* run, int tile, const PutPixel put_pixel) {
  for (int channel = 0; channel < kOut; channel += kLanes) {
    Lanes half[kTile][kSpan];
    for (int x = 0; x < kSpan; x++) {
      Lanes column[kSpan], out[kTile];
      for (int y = 0; y < kSpan; y++) column[y] = get(run + (size_t(y * kSpan + x) * kRun + tile) * kWidth + channel);
      from_domain(column, out);
      for (int y = 0; y < kTile; y++) half[y][x] = out[y];
    }
    for (int y = 0; y < kTile; y++) {
      Lanes out[kTile];
      from_domain(half[y], out);
      for (int x = 0; x < kTile; x++) put_pixel(y, x, channel, out[x]);
    }
  }
}

// One row of tiles through one convolution without its bias. put_tile(rows, columns, column, give) is called for every tile:
// how much of it lies inside, and where; give(put_pixel) makes its outputs. Tiles know all they need by value: a store of
// floats may, for all that the compiler knows, change anything that is kept behind a reference.
template <int kOut, typename PutTile>
inline void convolve_tiles(const Plane& from, const float* weights, int tile_row, float* run, const PutTile& put_tile) {
  const int rows = std::min(kTile, from.rows - kTile * tile_row);
  for (int first = 0; first < from.tile_columns(); first += kRun) {
    const int tiles = std::min(kRun, from.tile_columns() - first);
    const int whole = (tiles + kGroup - 1) / kGroup * kGroup;
    for (int tile = 0; tile < whole; tile++) {  // the last one again fills the group
      take_tile(from, tile_row, first + std::min(tile, tiles - 1), tile, run);
    }
    multiply<kOut>(weights, tiles, run);
    for (int tile = 0; tile < tiles; tile++) {
      const int left = kTile * (first + tile);
      put_tile(rows, std::min(kTile, from.columns - left), left, [=](auto put_pixel) { give_tile<kOut>(run, tile, put_pixel); });
    }
  }
}

}  // namespace
}  // namespace cags::lite
