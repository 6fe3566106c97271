// Error erosion: occluded pixels take the mean of the clean ones around them, ring by ring.
#pragma once
#include "align/stages.h"

#include <vector>

namespace cags::align {

struct Erosion {
  int width, height, radius, iterations, threads;
  // Whether a seen pixel shares its reference pixel with an occluded one, by pixel: such pixels are not averaged from.
  const uint8_t* occluder;  // [height, width]
};

// Each ring reads only the state before it, so the result does not depend on the order of `holes`. `state` of filled pixels
// becomes kFilled.
void erode(const Erosion& how, std::vector<int64_t> holes, uint8_t* state, float* rgb);

}  // namespace cags::align
