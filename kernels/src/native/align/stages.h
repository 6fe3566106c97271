// The row-wise stages of alignment and correction, in the variant for one instruction set.
#pragma once
#include "align/cags_align.h"

#include <cstdint>

namespace cags::align {

// A picture in the reference's view with a border of one repeated pixel, so that bilinear taps need no bounds.
struct Padded {
  float* data;  // [height + 2, width + 2, lanes]
  int width, height;
};

constexpr int kColourLanes = 4;  // r, g, b, unused
constexpr int kFieldLanes = 4;   // factor, offsets r, g, b
constexpr int kMoments = 13;     // see stages/fit.h
constexpr int kParts = 7;        // see stages/fit.h
constexpr int kRun = 64;         // pixels worked on at a time: what is known of them stays in the nearest cache
constexpr int kEvidenceRows = 4; // every fourth row is looked at
constexpr int kPowers = 3;       // see stages/carry.h
constexpr float kLeastCarried = 1e-12f;  // power that stands for none
constexpr float kNoiseFloor = 2e-6f;  // variance of rounding to 8 bits
constexpr float kVoidPower = 1e-4f;   // what has no more is void

// Depth bits above, the pixel's place below: the minimum is the nearest pixel and, of equally near ones, the first.
using Nearest = uint64_t;
constexpr Nearest kNobody = uint64_t{0x7F800000} << 32;

constexpr uint32_t place_of(int row, int column) { return static_cast<uint32_t>(row) << 16 | static_cast<uint32_t>(column); }
constexpr int row_of(uint32_t place) { return static_cast<int>(place >> 16); }
constexpr int column_of(uint32_t place) { return static_cast<int>(place & 0xFFFF); }

// What hides what, by reference pixel; cells have a row and a column more than the reference, for points on its edge.
struct Occlusion {
  const Nearest* nearest;      // [cells]
  const float* nearest_depth;  // [cells]: the depth of `nearest`, +inf where nobody is
  uint8_t* shared;             // [cells], or null: 1 where a hidden pixel lies. Rows write it side by side, the same value
};

// A worker's scratch of the local fit.
struct Ring {
  float* sums;  // [2 radius + 1, kMoments, kRun], of rows in turn
  float* line;  // [kMoments, kRun + 2 radius]
};

// Sums over a picture, luma and the two chromas.
struct Evidence {
  double fine[3], broad[3], noise[3];
  int64_t shown;  // pixels that are not void in both
};

// The client's picture in blocks of about a reference pixel: what alignment gets wrong, against what it is to bring.
struct Blocks {
  int size, width, height;  // client pixels a side; blocks
  float* disagreement;      // [3, height, width]: the picture less the client's own view through the alignment
  float* weight;            // [height, width]: of the correction
};

// Disagreement is averaged over kWindow x kWindow blocks before it is squared.
constexpr int kLineSlack = 8;  // blocks beyond a row's last
constexpr int kAround = 3, kWindow = 2 * kAround + 1;

// Sums over the blocks of a row that are seen: of the correction's power, and of the disagreement.
struct Agreement {
  double power, away[3];
  int64_t seen;
};

struct Stages {
  // One row: the nearest pixel of each cell that it touches.
  void (*nearest)(const CagsAlignInput&, int row, Nearest* cells);
  // One row: confidence, occlusion and, where they are wanted, colours before erosion.
  void (*resolve)(const CagsAlignInput&, const Padded& reference, const Occlusion&, int row, const CagsAlignOutput&);
  // Up to 64 pixels of a row, as bits: seen, and not in front of an occluded one (`shared` cells). `occluded` is the run's.
  uint64_t (*clean)(const CagsAlignInput&, const uint8_t* occluded, const uint8_t* shared, int row, int first, int count);
  // Rows of the reference from `begin` to `end`: parts [height, kParts, width] of the correction, and what every
  // kEvidenceRows-th row tells of the picture.
  void (*fit)(const CagsCorrectInput&, int begin, int end, const Ring&, float* parts, Evidence* evidence);
  // One row of the reference: factor and offset of the correction, and the client's own view, clipped; `share` [6] is the
  // trust in luma and chromas, fine and broad.
  void (*trust)(const CagsCorrectInput&, int row, const float* parts, const float* share, const Padded& fields,
                const Padded& own);
  // One row of the reference: the fields that are given, and the client's own view, clipped.
  void (*take)(const CagsCorrectInput&, int row, const Padded& fields, const Padded& own);
  // One row of blocks: disagreement, and its sums and the correction's power's added to `agreement`.
  void (*compare)(const CagsCorrectInput&, const Padded& fields, const Padded& own, int row, const Blocks& blocks,
                  Agreement& agreement);
  // One row of blocks: weights, given the mean power of the correction. `line` [2 blocks.width + 2 kAround] is scratch.
  void (*settle)(const CagsCorrectInput&, int row, float power, float share, const Blocks& blocks, float* line);
  // One row of a carried reference: horizontal sums [height, kPowers, width] of its powers, their means, and itself, given
  // the power that is too much of a correction. `line` [kPowers, width + 2 radius] is scratch.
  void (*carry_powers)(const CagsCarryInput&, int row, float* line, float* sums);
  void (*carry_means)(const CagsCarryInput&, int row, const float* sums, float* means);
  void (*carry)(const CagsCarryInput&, int row, const float* means, float most, float* carried);
  // One row of a picture laid over another, of which `shown` is the row.
  void (*lay)(const CagsLayInput&, int row, float* shown);
  // One row of the client's picture: distorted + weight confidence (factor distorted + offset), clipped.
  // `line` [blocks.width + kLineSlack] is scratch.
  void (*correct)(const CagsCorrectInput&, const Padded& fields, const Blocks& blocks, int row, float* line, float* restored);
};

extern const Stages stages_portable;
#ifdef CAGS_X86
extern const Stages stages_avx2, stages_avx512;
#endif

// Index of the pixel that a reflected border repeats (fedcba|abcdef|fedcba), for any distance outside.
inline int reflected(int i, int n) {
  while (i < 0 || i >= n) i = i < 0 ? -i - 1 : 2 * n - 1 - i;
  return i;
}

}  // namespace cags::align
