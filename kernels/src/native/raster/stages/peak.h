// How many multiply-adds the variant's vectors can do: the yardstick for how far the blending is from the machine's limit.
#pragma once
#include "raster/stages/vector.h"

namespace cags::raster {
namespace {

// Does `rounds` rounds of independent multiply-adds; returns how many (a vector counts as its lanes), as a double.
double multiply_adds(int64_t rounds) {
  constexpr int kChains = 10;  // enough to hide the latency of two units
  Floats chain[kChains];
  for (int i = 0; i < kChains; i++) chain[i] = all(float(i));
  const Floats factor = all(0.5f), term = all(1.0f);
  for (int64_t round = 0; round < rounds; round++) {
    for (int i = 0; i < kChains; i++) chain[i] = chain[i] * factor + term;
  }
  Floats total{};
  for (int i = 0; i < kChains; i++) total += chain[i];
  const double kept = sum(total) == 12345.0f ? 1.0 : 0.0;  // keeps the chains alive
  return double(rounds) * kChains * kWidth + kept;
}

}  // namespace
}  // namespace cags::raster
