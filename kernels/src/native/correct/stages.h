// The stages of the correction, in the variant for one instruction set.
#pragma once
#include "correct/cags_correct.h"

#include <cstddef>
#include <cstdint>

namespace cags::correct {

constexpr int kCell = 8;                     // pixels a side of the cells that fill holes: a vector's lanes
constexpr int kVetoCell = 16;                // pixels a side of a coarse veto's cells
constexpr float kLeastAround = 1;            // confident pixels of a cell: what is fewer says less of the hidden pixels around
constexpr int kRun = 64;                     // pixels worked on at a time: what is known of them stays in the nearest cache
constexpr int kLanes = 4;                    // red, green, blue, opacity
constexpr int kTap = 2 * kLanes;             // of a pixel and of the one to the right, lane beside lane
constexpr float kUnit = 32767;               // of what is lacking
constexpr float kFar = 1e6f;                 // depth where nothing is known anywhere, and the largest that counts
constexpr float kLeastDepth = 1e-6f;         // what is nearer is not known
constexpr int64_t kLeastStreamed = 400'000;  // pixels of a view too large for the caches

// Depth (bits of a positive float) and place (row and column) of the nearest client pixel in a reference pixel: the least is
// the nearest, and of equally near ones the first.
using Nearest = uint64_t;
constexpr Nearest kNobody = 0x7f800000ffffffffull;  // at infinity

inline size_t rounded_up(int count, int unit) { return size_t(count + unit - 1) / unit * unit; }

// Inverse depth of cells [rows, columns].
struct Cells {
  float* inverse;
  float* weight;  // share of the cell's pixels whose depth is known
  int rows, columns;
};

// Depth of a view, holes filled. Rows without holes are those of the view; others lie in `filled`, `pitch` apart, with zeros up
// to whole runs.
struct Depths {
  const float** rows;  // [height]
  float* filled;
  size_t pitch;

  static size_t pitch_of(int width) { return rounded_up(width, kRun); }
};

// A worker's scratch: a row of cells' depths, and lines as wide as a view.
struct Line {
  static size_t floats(int width) { return (kCell + 4) * part_of(width); }
  Line(float* memory, int width) : part(part_of(width)) {
    depth = memory, sums = memory + kCell * part, counts = sums + part, around = counts + part + kCell, keep = around + part;
  }
  float* row(int r) const { return depth + r * part; }

  size_t part;
  float* depth;  // rows of the view, zeros where nothing is known
  float *sums, *counts;
  float *around, *keep;  // `around` has one cell more on both sides

 private:
  static size_t part_of(int width) { return rounded_up(width, kRun) + 2 * kCell; }
};

constexpr int kAround = 3, kSide = 2 * kAround + 1;  // of the neighbourhoods in which a picture and the own view are compared
constexpr int kMoments = 9;                          // own colours, the picture's, own^2, own * picture, difference^2
constexpr float kNoiseWeight = 2;

// A worker's scratch for the comparison: what is known of the last seven rows.
struct Near {
  static size_t pitch_of(int width) { return rounded_up(width + 2 * kAround, kCell) + kCell; }
  static size_t floats(int width) { return (2 * kSide * kMoments + 1 + kLanes) * pitch_of(width); }
  Near(float* memory, int width) : pitch(pitch_of(width)), rows(memory) {
    wide = rows + 2 * kSide * kMoments * pitch, layer = wide + pitch;
  }
  float* planes(int row) const { return rows + size_t((row + kSide) % kSide) * kMoments * pitch; }
  float* sums(int row) const { return planes(row) + kSide * kMoments * pitch; }

  size_t pitch;
  float* rows;
  float *wide, *layer;  // a plane with its border; a row of the layer
};

struct Occlusion {
  const Nearest* nearest;  // [reference_height + 1, reference_width + 1]
  const float* limit;      // the same: depth behind which a pixel may be hidden
};

// Of the cells, what was added to their pixels, and where it is to be added too.
struct Around {
  float* sums;       // [rows, columns, kLanes]; the last lane is that of the confidence
  uint64_t* hidden;  // [height, runs], a bit a pixel: what the reference does not see
  int columns, runs;
};

struct Stages {
  // One row of what a difference says is lacking, without its border above and below.
  void (*expand)(const CagsLackInput&, int row, int16_t* to);
  // Sum of the squared differences of a picture and the own view over a row.
  double (*apart)(const CagsLackInput&, int row);
  // Rows of what a picture says is lacking, where it differs by more than `noise`.
  void (*compare)(const CagsLackInput&, float noise, int begin, int end, const Near&, int16_t* to);
  // One row of cells: means of inverse depth, and the pixels of known depth that are nearest. Returns whether there are holes.
  bool (*survey)(const CagsAddInput&, int row, const Line&, const Cells&, const Depths&, Nearest*);
  // One row of cells that has holes: they are filled, and those of their pixels that are nearest.
  void (*patch)(const CagsAddInput&, int row, const Line&, const Cells&, const Depths&, Nearest*);
  // One row of cells: the frame but for hidden pixels, whose weight stands in `confidence`. Returns whether there are any.
  bool (*finish)(const CagsAddInput&, int row, const Line&, const Depths&, const Occlusion&, const Around&, float* shown,
                 float* confidence);
  // One row of cells: the hidden pixels.
  void (*surround)(const CagsAddInput&, int row, const Around&, float* shown, float* confidence);
};

extern const Stages stages_portable;
#ifdef CAGS_X86
extern const Stages stages_avx2, stages_avx512;
#endif

}  // namespace cags::correct
