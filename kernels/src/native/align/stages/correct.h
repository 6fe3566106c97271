// The local fit of the reference on the client's own view, and the correction that it gives.
#pragma once
#include "align/stages/bilinear.h"

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
  const int w = in.reference_width, r = in.radius_cells;
  const int64_t start = int64_t{row} * w * 3;
  float* centre = line + r * kMomentLanes;
  for (int i = 0; i < w; i++) moment_of(in.own + start + 3 * i, in.reference + start + 3 * i, centre + i * kMomentLanes);
  for (int i = 1; i <= r; i++) {
    std::memcpy(centre - i * kMomentLanes, centre + reflected(-i, w) * kMomentLanes, kMomentLanes * sizeof(float));
    const int beyond = w - 1 + i;
    std::memcpy(centre + beyond * kMomentLanes, centre + reflected(beyond, w) * kMomentLanes, kMomentLanes * sizeof(float));
  }
  using Moment = Lanes<kMomentLanes>;
  for (int i = 0; i < w; i++) {
    Moment total = {};
    for (int j = 0; j <= 2 * r; j++) total += *reinterpret_cast<const Moment*>(line + (i + j) * kMomentLanes);
    std::memcpy(sums + (int64_t{row} * w + i) * kMomentLanes, &total, sizeof total);
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
  const int w = in.reference_width, h = in.reference_height, r = in.radius_cells;
  const float count = static_cast<float>((2 * r + 1) * (2 * r + 1));
  float* field = fields.data + ((int64_t{row} + 1) * (w + 2) + 1) * kFieldLanes;
  using Moment = Lanes<kMomentLanes>;
  for (int i = 0; i < w; i++) {
    Moment total = {};
    for (int j = -r; j <= r; j++) {
      total += *reinterpret_cast<const Moment*>(sums + (int64_t{reflected(row + j, h)} * w + i) * kMomentLanes);
    }
    total /= count;
    float m[kMomentLanes];
    std::memcpy(m, &total, sizeof m);
    const int64_t pixel = (int64_t{row} * w + i) * 3;
    fit_pixel(in, m, in.own + pixel, in.reference + pixel, field + i * kFieldLanes);
  }
  std::memcpy(field - kFieldLanes, field, kFieldLanes * sizeof(float));
  std::memcpy(field + w * kFieldLanes, field + (w - 1) * kFieldLanes, kFieldLanes * sizeof(float));
}

void correct(const CagsCorrectInput& in, const Padded& fields, int row, float* restored) {
  const int64_t start = int64_t{row} * in.width;
  for (int64_t i = start; i < start + in.width; i++) {
    const float share = in.confidence[i];
    const float* distorted = in.distorted + 3 * i;
    float* out = restored + 3 * i;
    float field[kFieldLanes] = {};
    if (share > 0) {
      const Lanes<kFieldLanes> sampled = bilinear<kFieldLanes>(fields, in.x[i], in.y[i]);
      std::memcpy(field, &sampled, sizeof field);
    }
    for (int c = 0; c < 3; c++) out[c] = clipped(distorted[c] + share * (distorted[c] * field[c] + field[4 + c]));
  }
}

}  // namespace
}  // namespace cags::align
