// Error erosion: occluded pixels take the mean of the clean ones around them, ring by ring.
#pragma once
#include "align/bits.h"
#include "support/aligned.h"

#include <cstdint>
#include <functional>

namespace cags::align {

constexpr int kMaxErosion = 31;  // radius: a window's half is less than a word

struct Erosion {
  int width, height, radius, iterations, threads;
};

// Which pixels of a row may be averaged from: bit i of word `word` is pixel kWord word + i. Asked near occluded pixels alone.
using CleanWord = std::function<uint64_t(int row, int word)>;

// Fills the pixels of `rgb` [height, width, 3] that `occluded` [height, width] names (1, else 0). Each ring reads what came
// before it alone, so that the result depends on no order. `memory` is scratch.
void erode(const Erosion& how, const uint8_t* occluded, const CleanWord& clean, AlignedArray<uint64_t>& memory, float* rgb);

}  // namespace cags::align
