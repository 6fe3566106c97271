// The local fit of the reference on the client's own view, and the correction that it gives.
#pragma once
#include "align/stages/bilinear.h"
#include "align/stages/projection.h"

namespace cags::align {
namespace {

// Lanes of a moment: own r g b, reference r g b, own^2 r g b, own reference r g b, mean squared difference.
constexpr int kOwn = 0, kReference = 3, kOwnSquared = 6, kProduct = 9, kDifference = 12;

inline float clipped(float value) { return std::min(std::max(value, 0.0f), 1.0f); }

inline void moment_of(const float* own, const float* reference, float* out) {
  float difference = 0.0f;
  for (int c = 0; c < 3; c++) {
    const float o = clipped(own[c]), r = reference[c];
    out[kOwn + c] = o;
    out[kReference + c] = r;
    out[kOwnSquared + c] = o * o;
    out[kProduct + c] = o * r;
    difference += (r - o) * (r - o);
  }
  out[kDifference] = difference / 3.0f;
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

// Weight of a signal whose measured power holds the noise too.
inline float wiener(float power, float noise) { return clipped(1.0f - noise / std::max(power, 1e-12f)); }

inline void fit_pixel(const CagsCorrectInput& in, const float* m, const float* own, const float* reference, float* field) {
  float broad[3], gain[3], variance_mean = 0.0f, broad_power = 0.0f;
  for (int c = 0; c < 3; c++) {
    const float o = m[kOwn + c], r = m[kReference + c];
    const float variance = std::max(m[kOwnSquared + c] - o * o, 0.0f);
    const float covariance = m[kProduct + c] - o * r;
    gain[c] = clipped((covariance + in.gain_prior) / (variance + in.gain_prior));
    broad[c] = r - o;
    variance_mean += variance / 3.0f;
    broad_power += broad[c] * broad[c] / 3.0f;
  }
  const float power = m[kDifference], noise = in.noise + in.detail_noise * variance_mean;
  const float weight = wiener(power, noise);
  const float weight_broad = wiener(broad_power, noise / static_cast<float>(2 * in.radius_cells + 1));
  const float weight_fine = wiener(power - broad_power, noise);
  for (int c = 0; c < 3; c++) {
    const float o = clipped(own[c]);
    const float correction = weight_broad * broad[c] + weight_fine * (reference[c] - o - broad[c]);
    const float factor = (gain[c] - 1.0f) * weight;
    field[c] = factor;
    field[4 + c] = correction - factor * o;
  }
  field[3] = field[7] = 0.0f;
}

void fit(const CagsCorrectInput& in, int row, const float* sums, const Padded& fields) {
  const int w = in.view.reference_width, h = in.view.reference_height, r = in.radius_cells;
  const float share = 1.0f / static_cast<float>((2 * r + 1) * (2 * r + 1));
  float* field = fields.data + ((int64_t{row} + 1) * (w + 2) + 1) * kFieldLanes;
  for (int i = 0; i < w; i++) {
    Eight low = {}, high = {};
    for (int j = -r; j <= r; j++) {
      const float* at = sums + (int64_t{reflected(row + j, h)} * w + i) * kMomentLanes;
      low += eight(at);
      high += eight(at + 8);
    }
    low *= share;
    high *= share;
    float m[kMomentLanes];
    std::memcpy(m, &low, sizeof low);
    std::memcpy(m + 8, &high, sizeof high);
    const int64_t pixel = (int64_t{row} * w + i) * 3;
    fit_pixel(in, m, in.own + pixel, in.reference + pixel, field + i * kFieldLanes);
  }
  std::memcpy(field - kFieldLanes, field, kFieldLanes * sizeof(float));
  std::memcpy(field + w * kFieldLanes, field + (w - 1) * kFieldLanes, kFieldLanes * sizeof(float));
}

inline void correct_run(const Projected& p, int count, const Padded& fields, const float* confidence, const float* distorted,
                        float* restored) {
  for (int i = 0; i < count; i++) {
    Eight field = {};
    if (confidence[i] > 0) field = bilinear_field(fields, p.x[i], p.y[i]) * confidence[i];
    const Four factor = __builtin_shufflevector(field, field, 0, 1, 2, 3), offset = __builtin_shufflevector(field, field, 4, 5, 6, 7);
    const float* d = distorted + 3 * i;
    const Four colour = {d[0], d[1], d[2], 0.0f};
    Four shown = colour + (colour * factor + offset);
    const Four zero = {}, one = {1.0f, 1.0f, 1.0f, 1.0f};
    shown = shown < zero ? zero : shown;
    shown = shown > one ? one : shown;
    // The fourth float is the next pixel's, which is written next; the last of a run must not touch it.
    std::memcpy(restored + 3 * i, &shown, i + 1 < count ? sizeof shown : 3 * sizeof(float));
  }
}

void correct(const CagsCorrectInput& in, const Padded& fields, int row, float* restored) {
  Projected p;
  for (int first = 0; first < in.view.width; first += kRun) {
    const int count = std::min(kRun, in.view.width - first);
    const int64_t start = int64_t{row} * in.view.width + first;
    project(in.view, row, first, 1, count, p);
    correct_run(p, count, fields, in.confidence + start, in.distorted + 3 * start, restored + 3 * start);
  }
}

}  // namespace
}  // namespace cags::align
