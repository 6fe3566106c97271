#include "align/erode.h"

#include "support/thread_pool.h"

#include <algorithm>
#include <bit>
#include <cstring>

namespace cags::align {
namespace {

constexpr int kChunk = 1024;  // holes a piece of work

struct Mean {
  float rgb[3];
  int count;
};

// Up to eight bytes of 0 or 1; may read kErosionSlack beyond them.
uint64_t bytes_at(const uint8_t* bytes, int count) {
  uint64_t eight;
  std::memcpy(&eight, bytes, sizeof eight);
  return count >= 8 ? eight : eight & ((uint64_t{1} << (8 * count)) - 1);
}

Mean mean_of_clean(const Erosion& how, const uint8_t* clean, const float* rgb, int64_t pixel) {
  const int row = static_cast<int>(pixel / how.width), column = static_cast<int>(pixel % how.width);
  const int top = std::max(row - how.radius, 0), bottom = std::min(row + how.radius, how.height - 1);
  const int left = std::max(column - how.radius, 0), right = std::min(column + how.radius, how.width - 1);
  Mean mean{{0, 0, 0}, 0};
  for (int y = top; y <= bottom; y++) {
    for (int x = left; x <= right; x += 8) {
      const int64_t start = int64_t{y} * how.width + x;
      for (uint64_t set = bytes_at(clean + start, right - x + 1); set; set &= set - 1) {
        const float* colour = rgb + 3 * (start + std::countr_zero(set) / 8);
        for (int c = 0; c < 3; c++) mean.rgb[c] += colour[c];
        mean.count++;
      }
    }
  }
  for (float& value : mean.rgb) value /= static_cast<float>(std::max(mean.count, 1));
  return mean;
}

}  // namespace

std::vector<int64_t> holes_of(const uint8_t* occluded, int64_t pixels) {
  std::vector<int64_t> holes;
  const uint8_t* end = occluded + pixels;
  for (const uint8_t* at = occluded; (at = static_cast<const uint8_t*>(std::memchr(at, 1, end - at))); at++) {
    holes.push_back(at - occluded);
  }
  return holes;
}

void erode(const Erosion& how, std::vector<int64_t> holes, uint8_t* clean, float* rgb) {
  std::vector<Mean> means;
  for (int ring = 0; ring < how.iterations && !holes.empty(); ring++) {
    means.resize(holes.size());
    const int chunks = static_cast<int>((holes.size() + kChunk - 1) / kChunk);
    parallel_for(how.threads, chunks, [&](int chunk, int) {
      const size_t end = std::min(holes.size(), (size_t(chunk) + 1) * kChunk);
      for (size_t i = size_t(chunk) * kChunk; i < end; i++) means[i] = mean_of_clean(how, clean, rgb, holes[i]);
    });
    size_t left = 0;
    for (size_t i = 0; i < holes.size(); i++) {
      const int64_t hole = holes[i];
      if (means[i].count == 0) {
        holes[left++] = hole;
        continue;
      }
      std::copy(means[i].rgb, means[i].rgb + 3, rgb + 3 * hole);
      clean[hole] = 1;
    }
    if (left == holes.size()) return;
    holes.resize(left);
  }
}

}  // namespace cags::align
