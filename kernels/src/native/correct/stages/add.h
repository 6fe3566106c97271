// The frame: what is lacking, sampled where the reference shows it, and laid over; where it is hidden there, the mean of what
// was added around.
#pragma once
#include "correct/stages/occlude.h"

#include <bit>
#include <cmath>
#include <cstdlib>

namespace cags::correct {
namespace {

// Of a run of pixels: where their taps begin, what they are weighed by, and what they are tested by.
struct Taps {
  int32_t first[kRun], cell[kRun];
  int32_t beside[kRun];        // two 16-bit weights of the left and the right pixel, in units of 1 / kUnit
  float down[kRun];            // share of the lower ones
  float top[kRun], low[kRun];  // weights of the two rows, with the confidence and the units
  float z[kRun], confidence[kRun];
};

inline float depth_at(const Depths& depths, int row, int column) { return std::min(depths.rows[row][column], kFar); }

// The smaller of the steps to the two neighbours along an axis; 0 where there is none.
inline float slope(const CagsAddInput& in, const Depths& depths, int row, int column, int down, int across) {
  const float here = depth_at(depths, row, column);
  float least = std::numeric_limits<float>::infinity();
  for (const int side : {-1, 1}) {
    const int r = row + side * down, c = column + side * across;
    if (r < 0 || c < 0 || r >= in.height || c >= in.width) continue;
    least = std::min(least, std::fabs(here - depth_at(depths, r, c)));
  }
  return least < std::numeric_limits<float>::infinity() ? least : 0.0f;
}

// Whether a pixel that lies `behind` its reference pixel's limit is hidden: behind even by the surface's own slope, and not
// within one reference pixel of the nearest in the client's view too, where the reference sees both.
inline bool hidden(const CagsAddInput& in, const Depths& depths, int row, int column, float behind, Nearest nearest) {
  const uint32_t place = static_cast<uint32_t>(nearest);
  const int rows_away = std::abs(row - static_cast<int>(place >> 16)),
            columns_away = std::abs(column - static_cast<int>(place & 0xffff));
  if (static_cast<float>(columns_away) <= in.cell_x && static_cast<float>(rows_away) <= in.cell_y) return false;
  const float across = in.slope_cells * in.cell_x * slope(in, depths, row, column, 0, 1);
  return behind > across && behind > across + in.slope_cells * in.cell_y * slope(in, depths, row, column, 1, 0);
}

// Returns whether anything is added to any pixel of the run. `alpha` is looked at with kHoles only.
template <bool kHoles>
inline bool place(const CagsAddInput& in, const Projection& project, int first, int count, const float* depth,
                  [[maybe_unused]] const float* alpha, Taps& taps) {
  const float fade = 1.0f / std::max(in.border_px, 1e-6f);
  [[maybe_unused]] const float opaque = 1.0f / std::max(in.hole_alpha, 1e-6f);
  const int across = in.reference_width + 1, wide = in.reference_width + 1;
  uint32_t any = 0;
  for (int i = 0; i < count; i += kCell) {
    const Placed p = project(kSteps + (static_cast<float>(first + i) + 0.5f), lesser(load(depth + i), all(kFar)));
    Eight certain = keep(p.ahead, clamped(1.0f - p.beyond * fade, 0, 1));
    any |= bits(certain > 0.0f);
    if constexpr (kHoles) {  // holes do not fade
      const Eight through = load(alpha + i);
      const EightInts hole = p.ahead & (through < all(in.hole_alpha));
      certain = greater(certain, keep(hole, clamped(1.0f - through * opaque, 0, 1)));
      any |= bits(hole);
    }
    store(taps.confidence + i, certain);
    store(taps.z + i, p.z);
    store(taps.cell + i, truncated(p.y) * across + truncated(p.x));
    // in the padded picture, whose pixel (1, 1) is the picture's (0, 0)
    const Eight x = p.x + 0.5f, y = p.y + 0.5f;
    const EightInts ix = truncated(x), iy = truncated(y);
    store(taps.first + i, kTap * (iy * wide + ix));
    const EightInts right = truncated((x - __builtin_convertvector(ix, Eight)) * kUnit + 0.5f);
    store(taps.beside + i, right * 65535 + 32767);  // the left one's weight is the rest
    store(taps.down + i, y - __builtin_convertvector(iy, Eight));
  }
  return any;
}

// The run's hidden pixels, one bit each.
inline uint64_t hide(const CagsAddInput& in, const Depths& depths, const Occlusion& occlusion, int row, int first, int count,
                     const Taps& taps) {
  float limit[kRun];
  for (int i = 0; i < count; i++) limit[i] = occlusion.limit[taps.cell[i]];
  uint64_t doubtful = 0, out = 0;
  for (int i = 0; i < count; i += kCell) doubtful |= uint64_t{bits(load(taps.z + i) > load(limit + i))} << i;
  if (count < kRun) doubtful &= (uint64_t{1} << count) - 1;
  for (; doubtful; doubtful &= doubtful - 1) {
    const int i = std::countr_zero(doubtful);
    const float behind = taps.z[i] - limit[i];
    if (hidden(in, depths, row, first + i, behind, occlusion.nearest[taps.cell[i]])) out |= uint64_t{1} << i;
  }
  return out;
}

// The weights of rows, once confidences are final.
inline void weigh(int count, Taps& taps) {
  for (int i = 0; i < count; i += kCell) {
    const Eight certain = load(taps.confidence + i) * (1.0f / (kUnit * kUnit)), low = certain * load(taps.down + i);
    store(taps.low + i, low);
    store(taps.top + i, certain - low);
  }
}

// What is added to one pixel by the upper row of its taps, and by the lower one.
inline Eight sampled(const int16_t* upper, int pitch, const Taps& taps, int i) {
  const int16_t *from = upper + taps.first[i], *lower = from + pitch;
#if defined(__AVX2__)
  const __m128i top = _mm_loadu_si128(reinterpret_cast<const __m128i*>(from)),
                low = _mm_loadu_si128(reinterpret_cast<const __m128i*>(lower));
  const __m256i both = _mm256_inserti128_si256(_mm256_castsi128_si256(top), low, 1);
  const Eight sums = Eight(_mm256_cvtepi32_ps(_mm256_madd_epi16(both, _mm256_set1_epi32(taps.beside[i]))));
#elif defined(__SSE2__)
  const __m128i weights = _mm_set1_epi32(taps.beside[i]);
  const __m128i top = _mm_madd_epi16(_mm_loadu_si128(reinterpret_cast<const __m128i*>(from)), weights);
  const __m128i low = _mm_madd_epi16(_mm_loadu_si128(reinterpret_cast<const __m128i*>(lower)), weights);
  const Eight sums = __builtin_shufflevector(Four(_mm_cvtepi32_ps(top)), Four(_mm_cvtepi32_ps(low)), 0, 1, 2, 3, 4, 5, 6, 7);
#else
  const int32_t right = taps.beside[i] >> 16, left = taps.beside[i] & 0xffff;
  Eight sums;
  for (int c = 0; c < kLanes; c++) {
    sums[c] = static_cast<float>(from[2 * c] * left + from[2 * c + 1] * right);
    sums[kLanes + c] = static_cast<float>(lower[2 * c] * left + lower[2 * c + 1] * right);
  }
#endif
  return sums * halves(taps.top[i], taps.low[i]);
}

// What was added to two pixels, their confidence in the last lane.
inline Eight with_confidence(const Eight& added, float low, float high) {
  constexpr EightInts last = {0, 0, 0, -1, 0, 0, 0, -1};
  return select(last, halves(low, high), added);
}

// `rgb` and `out` are runs of whole cells and four floats more; `sums` are those of the run's cells, to which theirs are added.
inline void add_run(const CagsAddInput& in, Taps& taps, int count, const float* rgb, float* out, float* sums) {
  const int pitch = kTap * (in.reference_width + 1);
  const int16_t* lack = in.lack;
  weigh(count, taps);
  for (int first = 0; first < count; first += kCell, sums += kLanes) {  // pixels after the last have no confidence
    Eight total = {};
    for (int i = first; i < first + kCell; i += 2) {
      const Eight a = sampled(lack, pitch, taps, i), b = sampled(lack, pitch, taps, i + 1);
      const Eight over =
          __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11) + __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
      const Eight opacity = __builtin_shufflevector(over, over, 3, 3, 3, 3, 7, 7, 7, 7);
      const Eight drawn = both(rgb + 3 * i, rgb + 3 * i + 3), added = over - opacity * drawn;
      total += with_confidence(added, taps.confidence[i], taps.confidence[i + 1]);
      const Eight shown = clamped(drawn + added, 0, 1);
      store(out + 3 * i, half<0>(shown));
      store(out + 3 * i + 3, half<1>(shown));
    }
    store(sums, load<Four>(sums) + (half<0>(total) + half<1>(total)));
  }
}

// Lanes of the eight pixels from the `first` on whose bits are set.
inline EightInts lanes_of(uint64_t pixels, int first) {
  constexpr EightInts each = {1, 2, 4, 8, 16, 32, 64, 128};
  return ((EightInts{} + static_cast<int32_t>(pixels >> first & 0xff)) & each) != 0;
}

// Takes the confidence of hidden pixels to `aside`.
inline void set_aside(uint64_t hidden, int count, Taps& taps, float* aside) {
  for (int i = 0; i < count; i += kCell) {
    const Eight here = load(taps.confidence + i);
    store(aside + i, here);
    store(taps.confidence + i, keep(~lanes_of(hidden, i), here));
  }
}

inline void put_back(uint64_t hidden, int count, const float* aside, Taps& taps) {
  for (int i = 0; i < count; i += kCell)
    store(taps.confidence + i, select(lanes_of(hidden, i), load(aside + i), load(taps.confidence + i)));
}

inline void clip_run(const float* rgb, int values, float* out) {
  for (int i = 0; i < values; i += 8) store(out + i, clamped(load(rgb + i), 0, 1));
}

// Copies past the caches where `streams` and the addresses allow it.
inline void put(float* to, const float* from, int count, [[maybe_unused]] bool streams) {
#if defined(__AVX2__)
  if (streams && reinterpret_cast<uintptr_t>(to) % sizeof(Eight) == 0) {
    const int whole = count / 8 * 8;
    for (int i = 0; i < whole; i += 8) _mm256_stream_ps(to + i, __m256(load(from + i)));
    to += whole, from += whole, count -= whole;
  }
#endif
  std::memcpy(to, from, count * sizeof(float));
}

// What a veto leaves of a row's confidence.
inline void keep_of(const CagsAddInput& in, int row, const Line& line) {
  if (!in.coarse_veto) {
    const float* veto = in.veto + int64_t{row} * in.width;
    for (int i = 0; i < in.width; i++) line.keep[i] = 1.0f - std::min(std::max(veto[i], 0.0f), 1.0f);
    return;
  }
  const int columns = (in.width + kVetoCell - 1) / kVetoCell, rows = (in.height + kVetoCell - 1) / kVetoCell;
  line_of(in.veto, columns, Between(row, kVetoCell, rows), line.around);
  for (int i = 0; i < in.width; i += kCell) {
    const int cell = i / kVetoCell, before = i % kVetoCell ? cell : cell - 1;  // the centre left of these eight pixels
    const Eight share = (kSteps + (i % kVetoCell ? 0.5f : kCell + 0.5f)) * (1.0f / kVetoCell);
    const float left = line.around[before], right = line.around[before + 1];
    store(line.keep + i, 1.0f - clamped(left + (right - left) * share, 0, 1));
  }
}

bool finish(const CagsAddInput& in, int cell_row, const Line& line, const Depths& depths, const Occlusion& occlusion,
            const Around& around, float* shown, float* confidence) {
  const bool streams = int64_t{in.width} * in.height >= kLeastStreamed;
  Taps taps;
  float colours[3 * kRun + 8], rest[3 * kRun + 8] = {}, rest_depth[kRun] = {}, rest_alpha[kRun] = {}, aside[kRun] = {};
  float* sums = around.sums + int64_t{cell_row} * around.columns * kLanes;
  std::fill_n(sums, int64_t{around.columns} * kLanes, 0.0f);
  uint64_t some = 0;
  for (int r = 0; r < rows_of(in, cell_row); r++) {
    const int row = cell_row * kCell + r;
    const Projection project(in, row);
    const bool holes = depths.rows[row] != in.depth + int64_t{row} * in.width;
    uint64_t* hidden_runs = around.hidden + int64_t{row} * around.runs;
    if (in.veto) keep_of(in, row, line);
    for (int first = 0; first < in.width; first += kRun) {
      const int count = std::min(kRun, in.width - first);
      const int64_t start = int64_t{row} * in.width + first;
      const float *rgb = in.rgb + 3 * start, *depth = depths.rows[row] + first, *alpha = in.alpha + start;
      uint64_t& hidden = hidden_runs[first / kRun] = 0;
      prefetch(rgb + 3 * kRun, 3 * kRun), prefetch(depth + kRun, kRun);
      const bool last = start + kRun + 3 > int64_t{in.width} * in.height;  // a vector might reach beyond the picture
      if (last || count < kRun) {
        std::memcpy(rest, rgb, 3 * count * sizeof(float));
        rgb = rest;
      }
      if (count < kRun) {
        std::copy_n(depth, count, rest_depth);
        depth = rest_depth;
        if (holes) std::copy_n(alpha, count, rest_alpha);
        alpha = rest_alpha;
      }
      const bool any = holes ? place<true>(in, project, first, count, depth, alpha, taps)
                             : place<false>(in, project, first, count, depth, alpha, taps);
      if (any) {
        hidden = hide(in, depths, occlusion, row, first, count, taps);
        if (in.veto) {
          for (int i = 0; i < count; i++) taps.confidence[i] *= line.keep[first + i];
        }
        if (hidden) set_aside(hidden, count, taps, aside);
        add_run(in, taps, count, rgb, colours, sums + first / kCell * kLanes);
        if (hidden) put_back(hidden, count, aside, taps);
        some |= hidden;
      } else {
        clip_run(rgb, 3 * count, colours);
      }
      put(shown + 3 * start, colours, 3 * count, streams);
      put(confidence + start, taps.confidence, count, streams);
    }
  }
#if defined(__x86_64__)
  if (streams) __builtin_ia32_sfence();
#endif
  return some;
}

// The cells' sums at the height of a row: what was added, and in the last lane the confidence by which it was.
struct Surroundings {
  Surroundings(const Around& around, int row, int rows) : columns(around.columns) {
    const Between at(row, kCell, rows);
    top = around.sums + int64_t{at.above} * columns * kLanes, low = around.sums + int64_t{at.below} * columns * kLanes,
    share = at.share;
  }

  Four operator()(int column) const {
    const int at = std::clamp(column, 0, columns - 1) * kLanes;
    const Four above = load<Four>(top + at);
    return above + (load<Four>(low + at) - above) * share;
  }

  int columns;
  const float *top, *low;
  float share;
};

// The eight pixels of a cell's row.
inline void surround_some(uint32_t hidden, const Surroundings& sums, int cell, const float* rgb, float* shown,
                          float* confidence) {
  const Four sides[3] = {sums(cell - 1), sums(cell), sums(cell + 1)};
  for (; hidden; hidden &= hidden - 1) {
    const int i = std::countr_zero(hidden), left = i / (kCell / 2);
    const Four around = sides[left] + (sides[left + 1] - sides[left]) * kBetween[i];
    const Four added = around * (confidence[i] / std::max(around[kLanes - 1], kLeastAround));
    for (int c = 0; c < 3; c++) shown[3 * i + c] = std::min(std::max(rgb[3 * i + c] + added[c], 0.0f), 1.0f);
    confidence[i] = 0.0f;
  }
}

// Asks for the hidden pixels of a row ahead of need: they are few and apart, and streamed out of the caches.
inline void prefetch_hidden(const CagsAddInput& in, const Around& around, int row, const float* shown, const float* confidence) {
  for (int run = 0; run < around.runs; run++) {
    uint64_t hidden = around.hidden[int64_t{row} * around.runs + run];
    for (int64_t at = int64_t{row} * in.width + int64_t{run} * kRun; hidden; at += kCell, hidden >>= kCell) {
      if (!(hidden & 0xff)) continue;
      __builtin_prefetch(confidence + at, 1);
      for (const int part : {0, 16}) __builtin_prefetch(in.rgb + 3 * at + part), __builtin_prefetch(shown + 3 * at + part, 1);
    }
  }
}

void surround(const CagsAddInput& in, int cell_row, const Around& around, float* shown, float* confidence) {
  const int first = cell_row * kCell, end = first + rows_of(in, cell_row);
  prefetch_hidden(in, around, first, shown, confidence);
  for (int row = first; row < end; row++) {
    if (row + 1 < end) prefetch_hidden(in, around, row + 1, shown, confidence);
    const Surroundings sums(around, row, (in.height + kCell - 1) / kCell);
    for (int run = 0; run < around.runs; run++) {
      uint64_t hidden = around.hidden[int64_t{row} * around.runs + run];
      const int64_t start = int64_t{row} * in.width + int64_t{run} * kRun;
      for (int i = 0; hidden; i += kCell, hidden >>= kCell) {
        const int64_t at = start + i;
        if (hidden & 0xff)
          surround_some(hidden & 0xff, sums, run * (kRun / kCell) + i / kCell, in.rgb + 3 * at, shown + 3 * at, confidence + at);
      }
    }
  }
}

}  // namespace
}  // namespace cags::correct
