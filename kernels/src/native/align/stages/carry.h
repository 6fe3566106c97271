// References of another media frame, carried to the one on display: see cags_client.carry.
#pragma once
#include "align/stages.h"
#include "align/stages/fit.h"

namespace cags::align {
namespace {

inline float square(float value) { return value * value; }

// Sums over the window's columns of the powers that `carry_means` means, [height, kPowers, width].
void carry_powers(const CagsCarryInput& in, int row, float* line, float* sums) {
  const int w = in.width, r = in.radius, stride = w + 2 * r;
  const int64_t start = 3 * int64_t{row} * w;
  const float *reference = in.reference + start, *then = in.then + start, *now = in.now + start;
  for (int i = 0; i < w; i++) {
    float residual = 0.0f, against_now = 0.0f, changed = 0.0f;
    for (int c = 3 * i; c < 3 * i + 3; c++) {
      const float before = clipped(then[c]), after = clipped(now[c]);
      residual += square(reference[c] - before);
      against_now += square(reference[c] - after);
      changed += square(after - before);
    }
    line[r + i] = residual, line[stride + r + i] = against_now, line[2 * stride + r + i] = changed;
  }
  float* out = sums + int64_t{row} * kPowers * w;
  for (int power = 0; power < kPowers; power++, line += stride, out += w) {
    mirror_ends(line, -r, w + 2 * r, w);
    add_lines([line](int j) { return line + j; }, 2 * r + 1, w, 1.0f, out);
  }
}

// Their means over the window: of the reference against then and against now, and of now against then.
void carry_means(const CagsCarryInput& in, int row, const float* sums, float* means) {
  const int w = in.width, r = in.radius, size = 2 * r + 1;
  for (int power = 0; power < kPowers; power++) {
    const auto at = [&](int j) { return sums + (int64_t{reflected(row + j - r, in.height)} * kPowers + power) * w; };
    add_lines(at, size, w, 1.0f / static_cast<float>(size * size), means + (int64_t{row} * kPowers + power) * w);
  }
}

void carry(const CagsCarryInput& in, int row, const float* means, float most, float* carried) {
  const int w = in.width;
  const float *against_then = means + int64_t{row} * kPowers * w, *against_now = against_then + w, *changed = against_now + w;
  const int64_t start = 3 * int64_t{row} * w;
  const float *reference = in.reference + start, *then = in.then + start, *now = in.now + start;
  for (int first = 0; first < w; first += kRun) {
    const int count = std::min(kRun, w - first);
    float kept[kRun], lost[kRun];
    for (int i = 0; i < count; i++) {
      const float a = against_then[first + i] + kLeastCarried, b = against_now[first + i];
      const float worth = std::min(a, b + kLeastCarried), plausible = std::min(most / worth, 1.0f);
      const float share = std::max(1.0f - b / a, 0.0f);
      kept[i] = plausible * ((1.0f - share) * worth / (worth + in.caution * changed[first + i]));
      lost[i] = (1.0f - plausible * share) - kept[i];
    }
    for (int i = 0; i < count; i++) {
      for (int c = 3 * (first + i); c < 3 * (first + i) + 3; c++) {
        const float after = clipped(now[c]);  // where nothing has changed, the reference stays as it is to the bit
        const float change = kept[i] * (after - clipped(then[c])) - lost[i] * (reference[c] - after);
        carried[start + c] = clipped(reference[c] + change);
      }
    }
  }
}

}  // namespace
}  // namespace cags::align
