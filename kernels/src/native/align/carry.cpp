// Carries a reference of another media frame to the one on display: see cags_client.carry.
#include "align/cags_align.h"
#include "align/calls.h"
#include "align/stages.h"

#include <algorithm>
#include <vector>

namespace cags::align {
namespace {

constexpr int kMaxSide = 16384;  // pixels
constexpr int kMaxRadius = 64;
constexpr int kEvidenceRows = 4;  // every fourth row is looked at

// The median; of an even number the mean of the two in the middle.
float median(std::vector<float>& values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2) return *middle;
  return 0.5f * (*std::max_element(values.begin(), middle) + *middle);
}

// What corrections are usually worth, where there is anything to correct.
float usual_worth(const CagsCarryInput& in, const float* means) {
  std::vector<float> worths;
  worths.reserve(size_t(in.width) * ((in.height + kEvidenceRows - 1) / kEvidenceRows));
  for (int row = 0; row < in.height; row += kEvidenceRows) {
    const float* against_then = means + int64_t{row} * kPowers * in.width;
    for (int i = 0; i < in.width; i++) {
      const float worth = std::min(against_then[i], against_then[in.width + i]) + kLeastCarried;
      if (worth > in.visible) worths.push_back(worth);
    }
  }
  return worths.empty() ? in.visible : median(worths);
}

void carry(const CagsCarryInput& in, float* carried) {
  ScratchLease scratch;
  const int threads = std::min(in.threads, kMaxThreads);
  const size_t values = size_t(in.width) * in.height * kPowers, line = size_t(in.width + 2 * in.radius) * kPowers;
  float* lines = scratch->lines.reserve(line * threads);
  float* sums = scratch->sums.reserve(values);
  float* means = scratch->means.reserve(values);
  for_rows(threads, in.height, [&](int row, int worker) { stages().carry_powers(in, row, lines + line * worker, sums); });
  for_rows(threads, in.height, [&](int row, int) { stages().carry_means(in, row, sums, means); });
  const float most = in.plausible * usual_worth(in, means);
  for_rows(threads, in.height, [&](int row, int) { stages().carry(in, row, means, most, carried); });
}

bool valid(const CagsCarryInput& in) {
  const auto side = [](int value) { return value >= 1 && value <= kMaxSide; };
  return side(in.width) && side(in.height) && in.radius >= 1 && in.radius <= kMaxRadius && in.threads >= 1;
}

}  // namespace
}  // namespace cags::align

int32_t cags_carry(const CagsCarryInput* input, float* carried) {
  using namespace cags::align;
  if (!valid(*input)) return CAGS_INVALID;
  return cags::guarded([&] { cags::align::carry(*input, carried); });
}
