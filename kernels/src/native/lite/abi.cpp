#include "lite/cags_lite.h"
#include "lite/stages.h"
#include "support/aligned.h"
#include "support/calls.h"
#include "support/float_mode.h"
#include "support/instruction_set.h"
#include "support/thread_pool.h"

#include <algorithm>

namespace cags::lite {
namespace {

constexpr int kMaxSide = 16384;  // pixels
constexpr int kMaxLayers = 64;

const Stages& stages() { return in_use(CAGS_VARIANTS(stages)); }

struct Scratch {
  AlignedArray<float> features, inner, power, runs, lines;
};

Plane plane_of(AlignedArray<float>& memory, int rows, int columns) {
  Plane plane{nullptr, rows, columns};
  plane.data = memory.reserve(plane.floats());
  return plane;
}

// Zeros around the pixels: what convolutions see there.
void clear_border(const Plane& plane) {
  const size_t stride = plane.stride(), inside = size_t(plane.columns) * kWidth;
  const size_t after = size_t(plane.rows + 1) * stride;
  std::fill_n(plane.data, stride, 0.0f);
  std::fill_n(plane.data + after, plane.floats() - after, 0.0f);
  for (int row = 0; row < plane.rows; row++) {
    float* first = plane.at(row, 0);
    std::fill_n(first - kWidth, kWidth, 0.0f);
    std::fill_n(first + inside, stride - kWidth - inside, 0.0f);
  }
}

void improve(const CagsLiteInput& in, float* improved) {
  Lease<Scratch> scratch;
  const int threads = std::min(in.threads, kMaxThreads), rows = in.height / 2, columns = in.width / 2;
  const Plane features = plane_of(scratch->features, rows, columns), inner = plane_of(scratch->inner, rows, columns);
  clear_border(features), clear_border(inner);
  float* power = scratch->power.reserve(size_t(rows) * columns);
  float* runs = scratch->runs.reserve(size_t(kRunFloats) * threads);
  const size_t line = (kEndingLines + 1) * ending_line(columns);
  float* lines = scratch->lines.reserve(line * threads);
  std::fill_n(lines, line * threads, 0.0f);

  parallel_for(threads, rows, [&](int row, int) {
    FlushDenormals flush;
    stages().head(in, row, features, power);
  });
  for (int i = 0; i < in.layers; i++) {
    const bool second = i % 2 != 0;
    const Layer layer{in.body + size_t(i) * kPlaces * kWidth * kWidth, in.body_bias + size_t(i) * kWidth, second};
    const Plane &from = second ? inner : features, &to = second ? features : inner;
    parallel_for(threads, from.tile_rows(), [&](int tile_row, int worker) {
      FlushDenormals flush;
      stages().convolve(from, layer, tile_row, to, runs + size_t(kRunFloats) * worker);
    });
  }
  parallel_for(threads, features.tile_rows(), [&](int tile_row, int worker) {
    FlushDenormals flush;
    stages().tail(in, features, tile_row, {power, lines + line * worker, improved}, runs + size_t(kRunFloats) * worker);
  });
}

bool valid(const CagsLiteInput& in) {
  const auto side = [](int32_t size) { return size >= 2 && size <= kMaxSide && size % 2 == 0; };
  return side(in.width) && side(in.height) && in.threads >= 1 && in.layers >= 0 && in.layers <= kMaxLayers && in.layers % 2 == 0 && in.factor_reach > 0 && in.colour_reach > 0;
}

}  // namespace
}  // namespace cags::lite

int32_t cags_lite(const CagsLiteInput* input, float* improved) {
  if (!cags::lite::valid(*input)) return CAGS_INVALID;
  return cags::guarded([&] { cags::lite::improve(*input, improved); });
}
