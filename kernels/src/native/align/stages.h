// The row-wise stages of alignment and correction, in the variant for one instruction set.
#pragma once
#include "align/cags_align.h"

#include <cstdint>

namespace cags::align {

// A reference picture with a border of one repeated pixel, so that bilinear taps need no bounds, in groups of `lanes` floats.
struct Padded {
  float* data;  // [height + 2, width + 2, lanes]
  int width, height;
};

constexpr int kColourLanes = 4;  // r, g, b, unused
constexpr int kFieldLanes = 8;   // factors r, g, b, unused, offsets r, g, b, unused
constexpr int kMomentLanes = 16;

// What a client pixel is to the reference.
enum State : uint8_t { kOutside = 0, kSeen = 1, kOccluded = 2, kFilled = 3 };

// Depth bits above, pixel index below: the minimum is the nearest pixel and, of equally near ones, the first.
using Nearest = uint64_t;
constexpr Nearest kNobody = uint64_t{0x7F800000} << 32;

struct Stages {
  // One row: where its pixels lie in the reference (x, y; z in `z`), their state, and the nearest pixel of each cell.
  void (*project)(const CagsAlignInput&, const CagsAlignOutput&, int row, float* z, uint8_t* state, Nearest* nearest);
  // One row: bilinear colours of the pixels that are in the reference, black elsewhere.
  void (*sample)(const CagsAlignInput&, const CagsAlignOutput&, const Padded& reference, const uint8_t* state, int row);
  // One row of the reference: horizontal sums of the moments that the local fit needs.
  void (*moments)(const CagsCorrectInput&, int row, float* line, float* sums);
  // One row of the reference: factor and offset of the correction from vertical sums of the moments.
  void (*fit)(const CagsCorrectInput&, int row, const float* sums, const Padded& fields);
  // One row of the client's picture: distorted + confidence (factor distorted + offset), clipped.
  void (*correct)(const CagsCorrectInput&, const Padded& fields, int row, float* restored);
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
