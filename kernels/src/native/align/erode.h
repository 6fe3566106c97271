// Error erosion: occluded pixels take the mean of the clean ones around them, ring by ring.
#pragma once
#include <cstdint>
#include <vector>

namespace cags::align {

constexpr int kErosionSlack = 8;  // bytes beyond `clean` that may be read

struct Erosion {
  int width, height, radius, iterations, threads;
};

// Indices, rising, of the bytes that are 1.
std::vector<int64_t> holes_of(const uint8_t* occluded, int64_t pixels);

// Each ring reads only the state before it, so the result does not depend on the order of `holes`. `clean` [height, width]
// tells which pixels may be averaged from; filled pixels become clean.
void erode(const Erosion& how, std::vector<int64_t> holes, uint8_t* clean, float* rgb);

}  // namespace cags::align
