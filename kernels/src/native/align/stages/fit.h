// The local fit of the reference on the client's own view, and the correction that it gives in the reference's view.
#pragma once
#include "align/stages/bilinear.h"

#include <cmath>

namespace cags::align {
namespace {

// Lanes of a moment, in luma and chromas: own, reference, own squared, product of the lumas, squared difference.
constexpr int kOwn = 0, kReference = 3, kOwnSquared = 6, kProduct = 9, kDifference = 10;

// BT.709 luma and chromas of display-referred RGB, and back.
inline void to_ycc(const float* rgb, float* ycc) {
  ycc[0] = 0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2];
  ycc[1] = -0.114572f * rgb[0] - 0.385428f * rgb[1] + 0.5f * rgb[2];
  ycc[2] = 0.5f * rgb[0] - 0.454153f * rgb[1] - 0.045847f * rgb[2];
}
inline void to_rgb(const float* ycc, float* rgb) {
  rgb[0] = ycc[0] + 1.5748f * ycc[2];
  rgb[1] = ycc[0] - 0.1873243f * ycc[1] - 0.4681243f * ycc[2];
  rgb[2] = ycc[0] + 1.8556f * ycc[1];
}

inline void moment_of(const float* own, const float* reference, float* out) {
  const float rgb[3] = {clipped(own[0]), clipped(own[1]), clipped(own[2])};
  to_ycc(rgb, out + kOwn);
  to_ycc(reference, out + kReference);
  out[kProduct] = out[kOwn] * out[kReference];
  for (int c = 0; c < 3; c++) {
    const float o = out[kOwn + c], difference = out[kReference + c] - o;
    out[kOwnSquared + c] = o * o;
    out[kDifference + c] = difference * difference;
  }
  out[13] = out[14] = out[15] = 0.0f;
}

void moments(const CagsCorrectInput& in, int row, float* line, float* sums) {
  const int w = in.view.reference_width, r = in.radius_cells;
  const int64_t start = int64_t{row} * w * 3;
  float* centre = line + r * kMomentLanes;
  for (int i = 0; i < w; i++) moment_of(in.own + start + 3 * i, in.reference + start + 3 * i, centre + i * kMomentLanes);
  for (int i = 1; i <= r; i++) {
    const int beyond = w - 1 + i;
    std::memcpy(centre - i * kMomentLanes, centre + reflected(-i, w) * kMomentLanes, kMomentLanes * sizeof(float));
    std::memcpy(centre + beyond * kMomentLanes, centre + reflected(beyond, w) * kMomentLanes, kMomentLanes * sizeof(float));
  }
  float* out = sums + start / 3 * kMomentLanes;
  for (int i = 0; i < w; i++, line += kMomentLanes, out += kMomentLanes) {
    Eight low = eight(line), high = eight(line + 8);
    for (int j = 1; j <= 2 * r; j++) {
      low += eight(line + j * kMomentLanes);
      high += eight(line + j * kMomentLanes + 8);
    }
    std::memcpy(out, &low, sizeof low);
    std::memcpy(out + 8, &high, sizeof high);
  }
}

// Means of the moments over the window around one pixel.
inline void window_means(const CagsCorrectInput& in, const float* sums, int row, int column, float* m) {
  const int w = in.view.reference_width, h = in.view.reference_height, r = in.radius_cells;
  const float share = 1.0f / static_cast<float>((2 * r + 1) * (2 * r + 1));
  Eight low = {}, high = {};
  for (int j = -r; j <= r; j++) {
    const float* at = sums + (int64_t{reflected(row + j, h)} * w + column) * kMomentLanes;
    low += eight(at);
    high += eight(at + 8);
  }
  low *= share;
  high *= share;
  std::memcpy(m, &low, sizeof low);
  std::memcpy(m + 8, &high, sizeof high);
}

inline void noise_of(const CagsCorrectInput& in, const float* m, float* variance, float* noise) {
  for (int c = 0; c < 3; c++) variance[c] = std::max(m[kOwnSquared + c] - m[kOwn + c] * m[kOwn + c], 0.0f);
  for (int c = 0; c < 3; c++) noise[c] = kNoiseFloor + in.fine_noise[c] * std::sqrt(variance[c]);
}

void weigh(const CagsCorrectInput& in, int row, const float* sums, Evidence& evidence) {
  for (int i = 0; i < in.view.reference_width; i++) {
    float m[kMomentLanes], variance[3], noise[3];
    window_means(in, sums, row, i, m);
    noise_of(in, m, variance, noise);
    if (m[kDifference] + 2.0f * m[kProduct] <= kVoidPower) continue;  // the sum of both pictures' powers
    evidence.shown++;
    for (int c = 0; c < 3; c++) {
      const float broad = m[kReference + c] - m[kOwn + c];
      evidence.fine[c] += m[kDifference + c] - broad * broad;
      evidence.broad[c] += broad * broad;
      evidence.noise[c] += noise[c];
    }
  }
}

// Weight of a signal whose measured power holds the noise too.
inline float wiener(float power, float noise) { return clipped(1.0f - noise / std::max(power, 1e-12f)); }

inline void fit_pixel(const CagsCorrectInput& in, const float* m, const float* trust, const float* own, const float* reference,
                      float* field) {
  float variance[3], noise[3], o[3], r[3], correction[3], offset[3];
  noise_of(in, m, variance, noise);
  const float rgb[3] = {clipped(own[0]), clipped(own[1]), clipped(own[2])};
  to_ycc(rgb, o);
  to_ycc(reference, r);
  for (int c = 0; c < 3; c++) {
    const float broad = m[kReference + c] - m[kOwn + c], power = m[kDifference + c];
    const float fine = r[c] - o[c] - broad;
    correction[c] = trust[3 + c] * wiener(broad * broad, kNoiseFloor + in.broad_noise[c]) * broad +
                    trust[c] * wiener(power - broad * broad, noise[c]) * fine;
  }
  to_rgb(correction, offset);
  const float covariance = m[kProduct] - m[kOwn] * m[kReference];
  const float gain = clipped((covariance + in.gain_prior) / (variance[0] + in.gain_prior));
  const float factor = (gain - 1.0f) * wiener(m[kDifference], noise[0]) * trust[0];
  field[0] = factor;
  for (int c = 0; c < 3; c++) field[1 + c] = offset[c] - factor * rgb[c];
}

void fit(const CagsCorrectInput& in, int row, const float* sums, const float* trust, const Padded& fields) {
  const int w = in.view.reference_width;
  float* field = fields.data + ((int64_t{row} + 1) * (w + 2) + 1) * kFieldLanes;
  for (int i = 0; i < w; i++) {
    float m[kMomentLanes];
    window_means(in, sums, row, i, m);
    const int64_t pixel = (int64_t{row} * w + i) * 3;
    fit_pixel(in, m, trust, in.own + pixel, in.reference + pixel, field + i * kFieldLanes);
  }
  std::memcpy(field - kFieldLanes, field, kFieldLanes * sizeof(float));
  std::memcpy(field + w * kFieldLanes, field + (w - 1) * kFieldLanes, kFieldLanes * sizeof(float));
}

}  // namespace
}  // namespace cags::align
