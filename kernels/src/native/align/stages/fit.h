// The local fit of the reference on the client's own view, and the correction that it gives in the reference's view.
// One array a quantity, so that every loop over pixels runs on whole vectors.
#pragma once
#include "align/stages/bilinear.h"
#include "align/stages/projection.h"

#include <cmath>

namespace cags::align {
namespace {

// Moments, in luma and chromas: own, reference, own squared, product of the lumas, squared difference.
constexpr int kOwn = 0, kReference = 3, kOwnSquared = 6, kProduct = 9, kDifference = 10;

// Parts of a correction before the whole picture tells how far each is trusted: luma and chromas, and the detail's gain.
constexpr int kBroad = 0, kFine = 3, kFactor = 6;

using Line = float[kRun];

// Where the sums of a row are kept of `rows` that are.
inline int place_in(int row, int rows) { return (row % rows + rows) % rows; }

// Pixels of a run of a row of the reference.
struct Pixels {
  Line rgb[3];                // own, in [0, 1]
  Line own[3], reference[3];  // BT.709 luma and chromas of display-referred RGB
};

inline void to_ycc(const Line* rgb, int count, Line* ycc) {
  for (int i = 0; i < count; i++) {
    const float r = rgb[0][i], g = rgb[1][i], b = rgb[2][i];
    ycc[0][i] = 0.2126f * r + 0.7152f * g + 0.0722f * b;
    ycc[1][i] = -0.114572f * r - 0.385428f * g + 0.5f * b;
    ycc[2][i] = 0.5f * r - 0.454153f * g - 0.045847f * b;
  }
}

inline int64_t pixel_at(const CagsCorrectInput& in, int row, int first) {
  return 3 * (int64_t{row} * in.view.reference_width + first);
}

inline void read_own(const CagsCorrectInput& in, int row, int first, int count, Line* rgb) {
  const float* own = in.own + pixel_at(in, row, first);
  for (int i = 0; i < count; i++) {
    for (int c = 0; c < 3; c++) rgb[c][i] = clipped(own[3 * i + c]);
  }
}

inline void read_pixels(const CagsCorrectInput& in, int row, int first, int count, Pixels& out) {
  const float* reference = in.reference + pixel_at(in, row, first);
  Line other[3];
  read_own(in, row, first, count, out.rgb);
  for (int i = 0; i < count; i++) {
    for (int c = 0; c < 3; c++) other[c][i] = reference[3 * i + c];
  }
  to_ycc(out.rgb, count, out.own);
  to_ycc(other, count, out.reference);
}

// Moments of single pixels to `out`, whose quantities lie `stride` apart.
inline void moments_of(const Pixels& p, int count, float* __restrict out, int stride) {
  for (int c = 0; c < 3; c++) {
    const float *own = p.own[c], *reference = p.reference[c];
    float* __restrict o = out + (kOwn + c) * stride;
    float* __restrict r = out + (kReference + c) * stride;
    float* __restrict squared = out + (kOwnSquared + c) * stride;
    float* __restrict difference = out + (kDifference + c) * stride;
    for (int i = 0; i < count; i++) {
      const float apart = reference[i] - own[i];
      o[i] = own[i], r[i] = reference[i], squared[i] = own[i] * own[i], difference[i] = apart * apart;
    }
  }
  float* __restrict product = out + kProduct * stride;
  for (int i = 0; i < count; i++) product[i] = p.own[0][i] * p.reference[0][i];
}

// Sum of five lines, in their order. Out of line, where its pointers have registers.
[[gnu::noinline]] inline void add_five(const float* a, const float* b, const float* c, const float* d, const float* e, int count,
                                       float share, float* __restrict out) {
  for (int i = 0; i < count; i++) out[i] = (a[i] + b[i] + c[i] + d[i] + e[i]) * share;
}

// The same of any number of lines: `at(j)` is the j-th. Five, those of the usual radius, have a loop of their own.
template <typename At>
inline void add_lines(const At& at, int lines, int count, float share, float* __restrict out) {
  if (lines == 5) return add_five(at(0), at(1), at(2), at(3), at(4), count, share, out);
  std::copy_n(at(0), count, out);
  for (int j = 1; j < lines; j++) {
    const float* line = at(j);
    for (int i = 0; i < count; i++) out[i] += line[i];
  }
  for (int i = 0; i < count; i++) out[i] *= share;
}

// Repeats beyond the picture's ends what is next to them: `line` holds columns from `first` on, `count` of them.
inline void mirror_ends(float* line, int first, int count, int width) {
  for (int i = 0; first + i < 0; i++) line[i] = line[reflected(first + i, width) - first];
  for (int i = count - 1; first + i >= width; i--) line[i] = line[reflected(first + i, width) - first];
}

// Horizontal window sums of the moments of a run of one row. `line` [kMoments, kRun + 2 radius] is scratch.
inline void sums_of(const CagsCorrectInput& in, int row, int first, int count, float* line, Line* sums) {
  const int r = in.radius_cells, stride = kRun + 2 * r, left = first - r, wide = count + 2 * r;
  Pixels pixels;
  for (int x = std::max(left, 0), end = std::min(left + wide, in.view.reference_width); x < end; x += kRun) {
    const int some = std::min(kRun, end - x);
    read_pixels(in, row, x, some, pixels);
    moments_of(pixels, some, line + x - left, stride);
  }
  for (int moment = 0; moment < kMoments; moment++, line += stride) {
    mirror_ends(line, left, wide, in.view.reference_width);
    add_lines([line](int j) { return line + j; }, 2 * r + 1, count, 1.0f, sums[moment]);
  }
}

// Means of the moments over the windows around a run of `row`, from the sums of the rows around it, each in its own place.
inline void window_means(const CagsCorrectInput& in, const Line* sums, int row, int count, Line* means) {
  const int r = in.radius_cells, rows = 2 * r + 1;
  const float share = 1.0f / static_cast<float>(rows * rows);
  for (int moment = 0; moment < kMoments; moment++) {
    add_lines([&](int j) { return sums[place_in(row + j - r, rows) * kMoments + moment]; }, rows, count, share, means[moment]);
  }
}

inline float variance_of(const Line* m, int c, int i) {
  return std::max(m[kOwnSquared + c][i] - m[kOwn + c][i] * m[kOwn + c][i], 0.0f);
}

// What a run tells of the picture, pixel by pixel: 0 where it is void in both.
inline void weigh(const CagsCorrectInput& in, const Line* m, int count, Evidence& evidence) {
  Line shown, fine, broad, noise;
  for (int i = 0; i < count; i++) {
    shown[i] = m[kDifference][i] + 2.0f * m[kProduct][i] > kVoidPower ? 1.0f : 0.0f;  // the sum of both powers
  }
  for (int i = 0; i < count; i++) evidence.shown += static_cast<int64_t>(shown[i]);
  for (int c = 0; c < 3; c++) {
    for (int i = 0; i < count; i++) {
      const float away = m[kReference + c][i] - m[kOwn + c][i];
      broad[i] = shown[i] * away * away;
      fine[i] = shown[i] * (m[kDifference + c][i] - away * away);
      noise[i] = shown[i] * (kNoiseFloor + in.fine_noise[c] * std::sqrt(variance_of(m, c, i)));
    }
    for (int i = 0; i < count; i++) evidence.fine[c] += fine[i], evidence.broad[c] += broad[i], evidence.noise[c] += noise[i];
  }
}

// Weight of a signal whose measured power holds the noise too.
inline float wiener(float power, float noise) { return clipped(1.0f - noise / std::max(power, 1e-12f)); }

// The correction of one component, luma or chroma: what is broad in it, and the rest.
inline void correct_component(const CagsCorrectInput& in, const Line* m, const Pixels& p, int c, int count,
                              float* __restrict broad_part, float* __restrict fine_part) {
  const float broad_noise = kNoiseFloor + in.broad_noise[c], share = in.fine_noise[c];
  for (int i = 0; i < count; i++) {
    const float noise = kNoiseFloor + share * std::sqrt(variance_of(m, c, i));
    const float broad = m[kReference + c][i] - m[kOwn + c][i], power = m[kDifference + c][i];
    const float fine = p.reference[c][i] - p.own[c][i] - broad;
    broad_part[i] = wiener(broad * broad, broad_noise) * broad;
    fine_part[i] = wiener(power - broad * broad, noise) * fine;
  }
}

// The change of the detail's gain.
inline void factors(const CagsCorrectInput& in, const Line* m, int count, float* __restrict out) {
  const float prior = in.gain_prior, share = in.fine_noise[0];
  for (int i = 0; i < count; i++) {
    const float variance = variance_of(m, 0, i), noise = kNoiseFloor + share * std::sqrt(variance);
    const float covariance = m[kProduct][i] - m[kOwn][i] * m[kReference][i];
    const float gain = clipped((covariance + prior) / (variance + prior));
    out[i] = (gain - 1.0f) * wiener(m[kDifference][i], noise);
  }
}

// One run of rows from `begin` to `end`, whose windows' sums stay in the nearest cache.
inline void fit_run(const CagsCorrectInput& in, int begin, int end, int first, int count, const Ring& ring, float* parts,
                    Evidence* evidence) {
  const int w = in.view.reference_width, r = in.radius_cells;
  Pixels pixels;
  Line m[kMoments];
  for (int next = begin - r; next < end + r; next++) {
    Line* sums = reinterpret_cast<Line*>(ring.sums);
    const int row = next - r;
    sums_of(in, reflected(next, in.view.reference_height), first, count, ring.line, sums + place_in(next, 2 * r + 1) * kMoments);
    if (row < begin) continue;
    window_means(in, sums, row, count, m);
    if (row % kEvidenceRows == 0) weigh(in, m, count, evidence[row / kEvidenceRows]);
    read_pixels(in, row, first, count, pixels);
    float* part = parts + int64_t{row} * kParts * w + first;
    for (int c = 0; c < 3; c++) correct_component(in, m, pixels, c, count, part + int64_t{kBroad + c} * w, part + int64_t{kFine + c} * w);
    factors(in, m, count, part + int64_t{kFactor} * w);
  }
}

void fit(const CagsCorrectInput& in, int begin, int end, const Ring& ring, float* parts, Evidence* evidence) {
  for (int first = 0; first < in.view.reference_width; first += kRun) {
    const int count = std::min(kRun, in.view.reference_width - first);
    fit_run(in, begin, end, first, count, ring, parts, evidence);
  }
}

// The client's own view, clipped, in four lanes.
inline void write_own(const Pixels& p, int count, float* __restrict own) {
  for (int i = 0; i < count; i++) {
    for (int c = 0; c < 3; c++) own[kColourLanes * i + c] = p.rgb[c][i];
    own[kColourLanes * i + 3] = 0.0f;
  }
}

// Repeats the outermost pixels of a row of four lanes.
inline void pad(float* row, int width) {
  std::memcpy(row - 4, row, 4 * sizeof(float));
  std::memcpy(row + 4 * width, row + 4 * (width - 1), 4 * sizeof(float));
}

// Factor and offsets, the correction's luma and chromas brought back to RGB.
inline void write_fields(const Pixels& p, const Line& factor, const Line* change, int count, float* __restrict field) {
  for (int i = 0; i < count; i++) {
    const float y = change[0][i], blue = change[1][i], red = change[2][i], f = factor[i];
    field[kFieldLanes * i] = f;
    field[kFieldLanes * i + 1] = y + 1.5748f * red - f * p.rgb[0][i];
    field[kFieldLanes * i + 2] = y - 0.1873243f * blue - 0.4681243f * red - f * p.rgb[1][i];
    field[kFieldLanes * i + 3] = y + 1.8556f * blue - f * p.rgb[2][i];
  }
}

void trust(const CagsCorrectInput& in, int row, const float* parts, const float* share, const Padded& fields, const Padded& own) {
  const int w = in.view.reference_width;
  const int64_t start = ((int64_t{row} + 1) * (w + 2) + 1) * kFieldLanes;
  float* field = fields.data + start;
  Pixels pixels;
  Line factor, change[3];
  for (int first = 0; first < w; first += kRun) {
    const int count = std::min(kRun, w - first);
    const float* part = parts + int64_t{row} * kParts * w + first;
    for (int c = 0; c < 3; c++) {
      const float *fine = part + int64_t{kFine + c} * w, *broad = part + int64_t{kBroad + c} * w;
      for (int i = 0; i < count; i++) change[c][i] = share[3 + c] * broad[i] + share[c] * fine[i];
    }
    for (int i = 0; i < count; i++) factor[i] = part[int64_t{kFactor} * w + i] * share[0];
    read_own(in, row, first, count, pixels.rgb);
    write_fields(pixels, factor, change, count, field + int64_t{first} * kFieldLanes);
    write_own(pixels, count, own.data + start + int64_t{first} * kColourLanes);
  }
  pad(field, w);
  pad(own.data + start, w);
}

void take(const CagsCorrectInput& in, int row, const Padded& fields, const Padded& own) {
  const int w = in.view.reference_width;
  const int64_t start = ((int64_t{row} + 1) * (w + 2) + 1) * kFieldLanes;
  const float* from = in.own + int64_t{row} * w * 3;
  float* to = own.data + start;
  for (int i = 0; i < w; i++) {
    for (int c = 0; c < 3; c++) to[kColourLanes * i + c] = clipped(from[3 * i + c]);
    to[kColourLanes * i + 3] = 0.0f;
  }
  std::copy_n(in.fields + int64_t{row} * w * kFieldLanes, w * kFieldLanes, fields.data + start);
  pad(fields.data + start, w);
  pad(to, w);
}

}  // namespace
}  // namespace cags::align
