// A picture drawn at half the resolution, brought up to the whole by cubic convolution (Keys 1981, a = -3/4).
#pragma once
#include "raster/layout.h"

#include <cstddef>

namespace cags::raster {
namespace {

// Weights of four neighbours a quarter of a pixel to the left of the third; to the right of the second they are reversed.
constexpr float kCubic[4] = {-0.03515625f, 0.26171875f, 0.87890625f, -0.10546875f};
constexpr int kChannels = 3;

inline int clamped(int i, int size) { return i < 0 ? 0 : i < size ? i : size - 1; }

inline float displayable(float v) { return v < 0.0f ? 0.0f : v > 1.0f ? 1.0f : v; }

// The neighbours of row `y` of the whole picture, weighted: a row of the half one in `row`, its ends repeated twice.
inline void blend_rows(const EnlargeJob& job, int y, float* row) {
  const int n = (job.width + 1) / 2 * kChannels, h = (job.height + 1) / 2, first = y / 2 - 2 + y % 2;
  const float* source[4];
  float k[4];
  for (int i = 0; i < 4; i++) {
    source[i] = job.half + size_t(clamped(first + i, h)) * n;
    k[i] = kCubic[y % 2 ? 3 - i : i];
  }
  float* middle = row + 2 * kChannels;
  for (int i = 0; i < n; i++) middle[i] = k[0] * source[0][i] + k[1] * source[1][i] + k[2] * source[2][i] + k[3] * source[3][i];
  for (int c = 0; c < kChannels; c++) {
    row[c] = row[kChannels + c] = middle[c];
    middle[n + c] = middle[n + kChannels + c] = middle[n - kChannels + c];
  }
}

// Row `y` of the whole picture; `row` has room for half a row and four pixels.
void enlarge(const EnlargeJob& job, int y, float* row) {
  blend_rows(job, y, row);
  float* to = job.whole + size_t(y) * job.width * kChannels;
  for (int x = 0; x < job.width / 2; x++)
    for (int c = 0; c < kChannels; c++) {
      const float* p = row + x * kChannels + c;
      const float a = p[0], b = p[kChannels], m = p[2 * kChannels], d = p[3 * kChannels], e = p[4 * kChannels];
      to[2 * x * kChannels + c] = displayable(kCubic[0] * a + kCubic[1] * b + kCubic[2] * m + kCubic[3] * d);
      to[(2 * x + 1) * kChannels + c] = displayable(kCubic[3] * b + kCubic[2] * m + kCubic[1] * d + kCubic[0] * e);
    }
  if (job.width % 2 == 0) return;
  for (int c = 0; c < kChannels; c++) {
    const float* p = row + ((job.width + 1) / 2 - 1) * kChannels + c;
    to[(job.width - 1) * kChannels + c] =
        displayable(kCubic[0] * p[0] + kCubic[1] * p[kChannels] + kCubic[2] * p[2 * kChannels] + kCubic[3] * p[3 * kChannels]);
  }
}

}  // namespace
}  // namespace cags::raster
