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

using Line = float[kRun];

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

inline void read_pixels(const CagsCorrectInput& in, int row, int first, int count, Pixels& out) {
  const int64_t start = 3 * (int64_t{row} * in.view.reference_width + first);
  const float* own = in.own + start;
  const float* reference = in.reference + start;
  Line other[3];
  for (int i = 0; i < count; i++) {
    for (int c = 0; c < 3; c++) out.rgb[c][i] = clipped(own[3 * i + c]);
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

// Sum of `kLines` lines, in their order, without going through memory between them.
template <int kLines, typename At>
inline void add_lines(const At& at, int count, float share, float* __restrict out) {
  const float* line[kLines];
  for (int j = 0; j < kLines; j++) line[j] = at(j);
  for (int i = 0; i < count; i++) {
    float sum = line[0][i];
    for (int j = 1; j < kLines; j++) sum += line[j][i];
    out[i] = sum * share;
  }
}

// The same of any number of lines: `at(j)` is the j-th. Five, those of the usual radius, have a loop of their own.
template <typename At>
inline void add_lines(const At& at, int lines, int count, float share, float* __restrict out) {
  if (lines == 5) return add_lines<5>(at, count, share, out);
  std::copy_n(at(0), count, out);
  for (int j = 1; j < lines; j++) {
    const float* line = at(j);
    for (int i = 0; i < count; i++) out[i] += line[i];
  }
  for (int i = 0; i < count; i++) out[i] *= share;
}

// Repeats what is next to a row's ends beyond them.
inline void mirror_ends(float* row, int width, int radius) {
  for (int i = 1; i <= radius; i++) row[-i] = row[reflected(-i, width)], row[width - 1 + i] = row[reflected(width - 1 + i, width)];
}

void moments(const CagsCorrectInput& in, int row, float* line, float* sums) {
  const int w = in.view.reference_width, r = in.radius_cells, stride = w + 2 * r;
  Pixels pixels;
  for (int first = 0; first < w; first += kRun) {
    const int count = std::min(kRun, w - first);
    read_pixels(in, row, first, count, pixels);
    moments_of(pixels, count, line + r + first, stride);
  }
  float* __restrict out = sums + int64_t{row} * kMoments * w;
  for (int moment = 0; moment < kMoments; moment++, line += stride, out += w) {
    mirror_ends(line + r, w, r);
    add_lines([line](int j) { return line + j; }, 2 * r + 1, w, 1.0f, out);
  }
}

// Means of the moments over the windows around a run of pixels.
inline void window_means(const CagsCorrectInput& in, const float* sums, int row, int first, int count, Line* means) {
  const int w = in.view.reference_width, h = in.view.reference_height, r = in.radius_cells;
  const float share = 1.0f / static_cast<float>((2 * r + 1) * (2 * r + 1));
  for (int moment = 0; moment < kMoments; moment++) {
    const auto at = [&](int j) { return sums + (int64_t{reflected(row + j - r, h)} * kMoments + moment) * w + first; };
    add_lines(at, 2 * r + 1, count, share, means[moment]);
  }
}

inline float variance_of(const Line* m, int c, int i) {
  return std::max(m[kOwnSquared + c][i] - m[kOwn + c][i] * m[kOwn + c][i], 0.0f);
}

// What one row tells of the picture, pixel by pixel: 0 where it is void in both.
void weigh(const CagsCorrectInput& in, int row, const float* sums, Evidence& evidence) {
  const int w = in.view.reference_width;
  Line m[kMoments], shown, fine, broad, noise;
  for (int first = 0; first < w; first += kRun) {
    const int count = std::min(kRun, w - first);
    window_means(in, sums, row, first, count, m);
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
}

// Weight of a signal whose measured power holds the noise too.
inline float wiener(float power, float noise) { return clipped(1.0f - noise / std::max(power, 1e-12f)); }

// The correction of one component, luma or chroma.
inline void correct_component(const CagsCorrectInput& in, const Line* m, const Pixels& p, const float* trust, int c, int count,
                              float* __restrict out) {
  const float trust_fine = trust[c], trust_broad = trust[3 + c], broad_noise = kNoiseFloor + in.broad_noise[c];
  const float share = in.fine_noise[c];
  for (int i = 0; i < count; i++) {
    const float noise = kNoiseFloor + share * std::sqrt(variance_of(m, c, i));
    const float broad = m[kReference + c][i] - m[kOwn + c][i], power = m[kDifference + c][i];
    const float fine = p.reference[c][i] - p.own[c][i] - broad;
    out[i] = trust_broad * wiener(broad * broad, broad_noise) * broad + trust_fine * wiener(power - broad * broad, noise) * fine;
  }
}

// The change of the detail's gain.
inline void factors(const CagsCorrectInput& in, const Line* m, float trust, int count, float* __restrict out) {
  const float prior = in.gain_prior, share = in.fine_noise[0];
  for (int i = 0; i < count; i++) {
    const float variance = variance_of(m, 0, i), noise = kNoiseFloor + share * std::sqrt(variance);
    const float covariance = m[kProduct][i] - m[kOwn][i] * m[kReference][i];
    const float gain = clipped((covariance + prior) / (variance + prior));
    out[i] = (gain - 1.0f) * wiener(m[kDifference][i], noise) * trust;
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

void fit(const CagsCorrectInput& in, int row, const float* sums, const float* trust, const Padded& fields, const Padded& own) {
  const int w = in.view.reference_width;
  const int64_t start = ((int64_t{row} + 1) * (w + 2) + 1) * kFieldLanes;
  float* field = fields.data + start;
  Pixels pixels;
  Line m[kMoments], factor, change[3];
  for (int first = 0; first < w; first += kRun) {
    const int count = std::min(kRun, w - first);
    window_means(in, sums, row, first, count, m);
    read_pixels(in, row, first, count, pixels);
    for (int c = 0; c < 3; c++) correct_component(in, m, pixels, trust, c, count, change[c]);
    factors(in, m, trust[0], count, factor);
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
