// A view drawn at half the resolution, brought up to the whole: colours and alpha by cubic convolution (Keys 1981, a = -3/4), depth
// between the pixels of one surface only.
#pragma once
#include "raster/layout.h"
#include "raster/stages/image.h"

#include <cmath>

namespace cags::raster {
namespace {

// Weights of four neighbours a quarter of a pixel to the left of the third; to the right of the second they are reversed.
constexpr float kCubic[4] = {-0.03515625f, 0.26171875f, 0.87890625f, -0.10546875f};
constexpr float kSameSurface = 0.05f;  // relative difference of depths

inline int clamped(int i, int size) { return i < 0 ? 0 : i < size ? i : size - 1; }

// The neighbours of row or column `at` of the whole image: the first of four in the half one.
inline int first_neighbour(int at) { return at / 2 - 2 + at % 2; }

// One row of the whole image of `channels` interleaved channels. `row` has room for half a row and four pixels.
template <int channels>
void upsample_cubic(const float* from, int width, int height, int y, float least, float most, float* row, float* to) {
  const int w = (width + 1) / 2, h = (height + 1) / 2, n = w * channels;
  const float* source[4];
  float k[4];
  for (int i = 0; i < 4; i++) {
    source[i] = from + size_t(clamped(first_neighbour(y) + i, h)) * n;
    k[i] = kCubic[y % 2 ? 3 - i : i];
  }
  float* middle = row + 2 * channels;
  for (int i = 0; i < n; i++) middle[i] = k[0] * source[0][i] + k[1] * source[1][i] + k[2] * source[2][i] + k[3] * source[3][i];
  for (int c = 0; c < channels; c++) {
    row[c] = row[channels + c] = middle[c];
    middle[n + c] = middle[n + channels + c] = middle[n - channels + c];
  }
  auto limited = [&](float v) { return v < least ? least : v > most ? most : v; };
  for (int x = 0; x < width / 2; x++)
    for (int c = 0; c < channels; c++) {
      const float* p = row + x * channels + c;
      const float a = p[0], b = p[channels], m = p[2 * channels], d = p[3 * channels], e = p[4 * channels];
      to[2 * x * channels + c] = limited(kCubic[0] * a + kCubic[1] * b + kCubic[2] * m + kCubic[3] * d);
      to[(2 * x + 1) * channels + c] = limited(kCubic[3] * b + kCubic[2] * m + kCubic[1] * d + kCubic[0] * e);
    }
  if (width % 2)
    for (int c = 0; c < channels; c++) {
      const float* p = row + (w - 1) * channels + c;
      to[(width - 1) * channels + c] =
          limited(kCubic[0] * p[0] + kCubic[1] * p[channels] + kCubic[2] * p[2 * channels] + kCubic[3] * p[3 * channels]);
    }
}

// One row of depths: bilinear among the neighbours that lie on the nearest one's surface; infinite where `alpha` is void.
inline void upsample_depth(const float* from, const float* alpha, int width, int height, int y, float void_alpha, float* to) {
  const int w = (width + 1) / 2, h = (height + 1) / 2;
  const float* near_row = from + size_t(y / 2) * w;
  const float* far_row = from + size_t(clamped(y / 2 + (y % 2 ? 1 : -1), h)) * w;
  for (int x = 0; x < width; x++) {
    const int beside = clamped(x / 2 + (x % 2 ? 1 : -1), w);
    const float z = near_row[x / 2];
    auto on_surface = [&](float other) { return std::fabs(other - z) <= kSameSurface * z ? other : z; };
    const float mixed = z * 0.5625f + on_surface(near_row[beside]) * 0.1875f + on_surface(far_row[x / 2]) * 0.1875f +
                        on_surface(far_row[beside]) * 0.0625f;
    to[x] = alpha[x] >= void_alpha && alpha[x] > 0.0f ? mixed : kVoidDepth;
  }
}

void upsample(const UpsampleJob& job, int y, float* row) {
  const size_t at = size_t(y) * job.width;
  upsample_cubic<3>(job.half.rgb, job.width, job.height, y, 0.0f, job.brightest, row, job.whole.rgb + 3 * at);
  if (!job.half.alpha) return;
  upsample_cubic<1>(job.half.alpha, job.width, job.height, y, 0.0f, 1.0f, row, job.whole.alpha + at);
  if (job.half.depth)
    upsample_depth(job.half.depth, job.whole.alpha + at, job.width, job.height, y, job.void_alpha, job.whole.depth + at);
}

}  // namespace
}  // namespace cags::raster
