// The frame: what is lacking, sampled where the reference shows it, and added.
#pragma once
#include "correct/stages/occlude.h"

#include <cmath>
#include <cstdlib>

namespace cags::correct {
namespace {

// Of a run of pixels: where their taps begin, what they are weighed by, and what they are tested by.
struct Taps {
  int32_t first[kRun], cell[kRun];
  int32_t beside[kRun];            // two 16-bit weights of the left and the right pixel, in units of 1 / kUnit
  float down[kRun];                // share of the lower ones
  float top[kRun], low[kRun];      // weights of the two rows, with the confidence and the units
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
  const int rows_away = std::abs(row - static_cast<int>(place >> 16)), columns_away = std::abs(column - static_cast<int>(place & 0xffff));
  if (static_cast<float>(columns_away) <= in.cell_x && static_cast<float>(rows_away) <= in.cell_y) return false;
  const float across = in.slope_cells * in.cell_x * slope(in, depths, row, column, 0, 1);
  return behind > across && behind > across + in.slope_cells * in.cell_y * slope(in, depths, row, column, 1, 0);
}

// Returns whether any pixel of the run lies in the reference.
inline bool place(const CagsAddInput& in, const Projection& project, int first, int count, const float* depth, Taps& taps) {
  const float fade = 1.0f / std::max(in.border_px, 1e-6f);
  const int across = in.reference_width + 1, wide = in.reference_width + 1;
  uint32_t any = 0;
  for (int i = 0; i < count; i += kCell) {
    const Placed p = project(kSteps + (static_cast<float>(first + i) + 0.5f), lesser(load(depth + i), all(kFar)));
    any |= bits(p.inside);
    const Eight distance = lesser(lesser(p.x, project.right - p.x), lesser(p.y, project.bottom - p.y));
    store(taps.confidence + i, keep(p.inside, clamped(distance * fade, 0, 1)));
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

inline void hide(const CagsAddInput& in, const Depths& depths, const Occlusion& occlusion, int row, int first, int count, Taps& taps) {
  float limit[kRun];
  for (int i = 0; i < count; i++) limit[i] = occlusion.limit[taps.cell[i]];
  uint64_t doubtful = 0;
  for (int i = 0; i < count; i += kCell) doubtful |= uint64_t{bits(load(taps.z + i) > load(limit + i))} << i;
  if (count < kRun) doubtful &= (uint64_t{1} << count) - 1;
  for (; doubtful; doubtful &= doubtful - 1) {
    const int i = std::countr_zero(doubtful);
    const float behind = taps.z[i] - limit[i];
    if (hidden(in, depths, row, first + i, behind, occlusion.nearest[taps.cell[i]])) taps.confidence[i] = 0.0f;
  }
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
  const __m128i top = _mm_loadu_si128(reinterpret_cast<const __m128i*>(from)), low = _mm_loadu_si128(reinterpret_cast<const __m128i*>(lower));
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

// `rgb` and `out` are runs of whole pixels and four floats more.
inline void add_run(const CagsAddInput& in, Taps& taps, int count, const float* rgb, float* out) {
  const int pitch = kTap * (in.reference_width + 1);
  const int16_t* lack = in.lack;
  weigh(count, taps);
  for (int i = 0; i < count; i += 2) {  // of an odd run the last pair's second pixel has no confidence
    const Eight a = sampled(lack, pitch, taps, i), b = sampled(lack, pitch, taps, i + 1);
    const Eight added = __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11) + __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
    const Eight shown = clamped(both(rgb + 3 * i, rgb + 3 * i + 3) + added, 0, 1);
    store(out + 3 * i, half<0>(shown));
    store(out + 3 * i + 3, half<1>(shown));
  }
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

void finish(const CagsAddInput& in, int cell_row, const Line& line, const Depths& depths, const Occlusion& occlusion, float* shown,
            float* confidence) {
  const bool streams = int64_t{in.width} * in.height >= kLeastStreamed;
  Taps taps;
  float colours[3 * kRun + 8], rest[3 * kRun + 8] = {}, rest_depth[kRun] = {};
  for (int r = 0; r < rows_of(in, cell_row); r++) {
    const int row = cell_row * kCell + r;
    const Projection project(in, row);
    if (in.veto) keep_of(in, row, line);
    for (int first = 0; first < in.width; first += kRun) {
      const int count = std::min(kRun, in.width - first);
      const int64_t start = int64_t{row} * in.width + first;
      const float *rgb = in.rgb + 3 * start, *depth = depths.rows[row] + first;
      prefetch(rgb + 3 * kRun, 3 * kRun), prefetch(depth + kRun, kRun);
      const bool last = start + kRun + 3 > int64_t{in.width} * in.height;  // a vector might reach beyond the picture
      if (last || count < kRun) {
        std::memcpy(rest, rgb, 3 * count * sizeof(float));
        rgb = rest;
      }
      if (count < kRun) {
        std::copy_n(depth, count, rest_depth);
        depth = rest_depth;
      }
      if (place(in, project, first, count, depth, taps)) {
        hide(in, depths, occlusion, row, first, count, taps);
        if (in.veto) {
          for (int i = 0; i < count; i++) taps.confidence[i] *= line.keep[first + i];
        }
        add_run(in, taps, count, rgb, colours);
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
}

}  // namespace
}  // namespace cags::correct
