// The order in which the splats of a knot are coded: groups of halved strides, each between those that came before.
#pragma once
#include <cstdint>
#include <iterator>

namespace cags::motion {

inline constexpr int kStrides[] = {256, 128, 64, 32, 16, 8, 4, 2, 1};
inline constexpr int kGroups = std::size(kStrides);
inline constexpr int kFirstGroups = 4, kFirstFiner = 2;  // of which every other splat is predicted, in finer units

// Splats that are coded together: `first`, `first + step`, ...; those after the first group have neighbours.
struct Group {
  int first, step, count;
  bool between;
  int finer;  // so many times the level's unit

  Group(int index, int splats) : between(index > 0), finer(index < kFirstGroups ? kFirstFiner : 1) {
    first = between ? kStrides[index] : 0, step = between ? 2 * kStrides[index] : kStrides[0];
    count = splats > first ? (splats - first + step - 1) / step : 0;
  }
  int splat(int k) const { return first + k * step; }
};

}  // namespace cags::motion
