// The row-wise stages of the network `lite`, in the variant for one instruction set. Blocks of 2 x 2 pixels are the network's
// pixels; "rows" and "columns" are theirs.
#pragma once
#include "lite/cags_lite.h"

#include <cstddef>

namespace cags::lite {

constexpr int kWidth = 24;    // channels inside
constexpr int kSeen = 10;     // own RGB, difference RGB, correction RGB, factor
constexpr int kFieldLanes = 4;
constexpr int kAnswer = 4 * kFieldLanes;
constexpr int kTile = 4;                            // outputs a side of a tile
constexpr int kSpan = kTile + 2;                    // inputs a side of a tile
constexpr int kPlaces = kSpan * kSpan;              // of Winograd's domain
constexpr int kRun = 16;                            // tiles that are transformed before they are multiplied
constexpr int kRunFloats = kPlaces * kRun * kWidth;  // 55 kB, which stays in the second cache beside the weights

// Feature maps, with a border of zeros as wide as tiles reach.
struct Plane {
  float* data;  // [kTile tile_rows + 2, kTile tile_columns + 2, kWidth]; (1, 1) is the first pixel
  int rows, columns;

  int tile_rows() const { return (rows + kTile - 1) / kTile; }
  int tile_columns() const { return (columns + kTile - 1) / kTile; }
  size_t stride() const { return size_t(kTile * tile_columns() + 2) * kWidth; }
  size_t floats() const { return size_t(kTile * tile_rows() + 2) * stride(); }
  float* at(int row, int column) const { return data + (row + 1) * stride() + size_t(column + 1) * kWidth; }
};

struct Layer {
  const float *weights, *bias;
  bool adds;  // to what `to` holds
};

// Rows of the picture that a row of tiles makes, and the floats that each of them takes in a worker's scratch.
constexpr int kEndingLines = 2 * kTile;
constexpr size_t ending_line(int columns) { return (size_t(columns) * 2 * kFieldLanes + 15) / 16 * 16; }

// What the last stage needs besides features. `lines` [kEndingLines + 1, ending_line] is a worker's scratch.
struct Ending {
  const float* power;  // [rows, columns]: mean size of the closed form's correction
  float* lines;
  float* improved;
};

struct Stages {
  // One row of blocks: features of what is seen, and the mean size of the correction.
  void (*head)(const CagsLiteInput&, int row, const Plane& to, float* power);
  // One row of tiles: to (+)= leaky(convolved(from) + bias). `run` [kRunFloats] is a worker's scratch.
  void (*convolve)(const Plane& from, const Layer&, int tile_row, const Plane& to, float* run);
  // One row of tiles: the fields, changed by what the features say as far as the gate is open.
  void (*tail)(const CagsLiteInput&, const Plane& from, int tile_row, const Ending&, float* run);
};

extern const Stages stages_portable;
#ifdef CAGS_X86
extern const Stages stages_avx2, stages_avx512;
#endif

}  // namespace cags::lite
