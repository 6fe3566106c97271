// Stage 4: which blocks of a tile each splat of a batch reaches, as a bit set of blocks a row of them.
#pragma once
#include "raster/layout.h"
#include "raster/stages/vector.h"

namespace cags::raster {
namespace {

constexpr float kCoverSlack = 1e-3f;  // pixels

// A batch's ellipses: reach >= s^2 + t^2, see Record; x and y are the centre relative to the tile's first pixel.
struct alignas(64) Ellipses {
  float x[kBatch], y[kBatch], l11[kBatch], l12[kBatch], l22[kBatch], reach[kBatch];
};

// Which blocks of each row of blocks a splat of the batch reaches: one bit a block.
struct alignas(64) Membership {
  uint8_t row[kBlocksPerSide][kBatch];
};

// What bounds an ellipse, for a group of kWidth of them.
struct Bounds {
  Floats y, half_height, first_row, last_row;
  Floats x, slope, inverse_l11, l22, reach, widest, slack;  // slope: of the line through the rows' midpoints
};

inline Floats floor_of(Floats v) {  // for |v| <= 1024
  return __builtin_convertvector(__builtin_convertvector(v + 1024.0f, Ints), Floats) - 1024.0f;
}

inline Bounds bounds_of(const Ellipses& e, int i) {
  Bounds b;
  const Floats l12 = load(e.l12 + i);
  b.x = load(e.x + i), b.y = load(e.y + i), b.l22 = load(e.l22 + i), b.reach = load(e.reach + i);
  b.inverse_l11 = 1.0f / load(e.l11 + i);
  b.slope = -l12 * b.inverse_l11;
  b.half_height = square_root(b.reach) / b.l22;
  const Floats norm = square_root(b.l22 * b.l22 + l12 * l12);
  b.widest = -b.half_height * l12 / norm;  // y, from the centre, of the rightmost point
  b.slack = kCoverSlack + 1e-6f * (b.half_height + square_root(b.reach) * norm / b.l22 * b.inverse_l11);
  const Floats low = clamp(b.y - b.half_height - b.slack, all(-1.0f), all(float(kTile)));
  const Floats high = clamp(b.y + b.half_height + b.slack, all(-1.0f), all(float(kTile)));
  b.first_row = -floor_of(-low), b.last_row = floor_of(high);
  return b;
}

// Bit set of the blocks of one row of blocks that each ellipse touches.
inline Ints blocks_of_row(const Bounds& b, int row) {
  const Floats first = greater(b.first_row, all(float(row * kBlock)));
  const Floats last = lesser(b.last_row, all(float(row * kBlock + kBlock - 1)));
  const Floats low = first - b.y, high = last - b.y;  // y, from the centre
  const Floats right = clamp(b.widest, low, high), left = clamp(-b.widest, low, high);
  const Floats tr = b.l22 * right, tl = b.l22 * left;
  const Floats half_r = square_root(greater(b.reach - tr * tr, all(0.0f))) * b.inverse_l11;
  const Floats half_l = square_root(greater(b.reach - tl * tl, all(0.0f))) * b.inverse_l11;
  // Truncation after the clamp to [0, 32] is floor; a left end is rounded up by its slack's complement.
  const Floats end = b.x + b.slope * right + half_r + b.slack, begin = b.x + b.slope * left - half_l - b.slack;
  const Ints last_column = __builtin_convertvector(clamp(end, all(-1.0f), all(float(kTile - 1))) + 1.0f, Ints) - 1;
  const Ints first_column = kTile - __builtin_convertvector(kTile - clamp(begin, all(0.0f), all(float(kTile))), Ints);
  const Ints some = (first <= last) & (first_column <= last_column);
  const Ints one = Ints{} + 1;
  const Ints upto = ((one + 1) << ((last_column >> 2) & 31)) - 1, under = (one << ((first_column >> 2) & 31)) - 1;
  return some & upto & ~under & 255;
}
static_assert(kBlock == 4 && kTile == 32);

// Bit `column` of 64 bytes, gathered into one word.
inline uint64_t gather_bit(const uint8_t* bytes, int column) {
#if defined(__AVX512BW__)
  return _mm512_test_epi8_mask(_mm512_loadu_si512(bytes), _mm512_set1_epi8(char(1 << column)));
#elif defined(__AVX2__)
  const __m128i shift = _mm_cvtsi32_si128(7 - column);
  const __m256i low = _mm256_sll_epi16(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(bytes)), shift);
  const __m256i high = _mm256_sll_epi16(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(bytes + 32)), shift);
  return uint32_t(_mm256_movemask_epi8(low)) | uint64_t(uint32_t(_mm256_movemask_epi8(high))) << 32;
#else
  uint64_t out = 0;
  for (int i = 0; i < 64; i++) out |= uint64_t(bytes[i] >> column & 1) << i;
  return out;
#endif
}

// Fills the first n splats of `out` and as many more as make a multiple of 64; ellipses beyond n must reach nothing.
inline void cover(const Ellipses& ellipses, int n, Membership& out) {
  for (int i = 0; i < (n + kWordBits - 1) / kWordBits * kWordBits; i += kWidth) {
    const Bounds b = bounds_of(ellipses, i);
    for (int row = 0; row < kBlocksPerSide; row++) store_low_bytes(blocks_of_row(b, row), out.row[row] + i);
  }
}

}  // namespace
}  // namespace cags::raster
