#include "raster/scene.h"

#include "support/thread_pool.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>

namespace cags::raster {
namespace {

enum Plane { kMean = 0, kAxes = 3, kOpacity = 12, kBase = 13, kPlanes = 16 };

constexpr double kShC0 = 0.28209479177387814;
constexpr double kLog2E = 1.4426950408889634;
constexpr float kInvisible = -1e6f;   // log2 of an opacity that draws nothing
constexpr double kLeastNorm = 1e-12;  // a shorter quaternion has no direction
constexpr int kMoveChunk = 1024;      // splats
constexpr int kLoadChunk = 4096;      // splats; a multiple of kLanes, so that no two threads write one block

// FNV-1a over the 32-bit words of a splat, then a finaliser: equal for equal splats, whatever their place in the scene.
class ContentHash {
 public:
  explicit ContentHash(uint32_t state = 2166136261u) : state_(state) {}
  void add(const float* values, int count) {
    for (int i = 0; i < count; i++) {
      uint32_t word;
      std::memcpy(&word, values + i, sizeof word);
      state_ = (state_ ^ word) * 16777619u;
    }
  }
  uint32_t state() const { return state_; }
  uint32_t value() const {
    uint32_t h = state_;
    h = (h ^ (h >> 15)) * 0x2c1b3c6du;
    return h ^ (h >> 12);
  }

 private:
  uint32_t state_;
};

// Row-major rotation matrix x diag(scale) of a quaternion that need not be unit.
void scaled_axes(const float* quat, const float* scale, double out[9]) {
  double w = quat[0], x = quat[1], y = quat[2], z = quat[3];
  const double norm = std::sqrt(w * w + x * x + y * y + z * z);
  w /= norm, x /= norm, y /= norm, z /= norm;
  const double rotation[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                              2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                              2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
  for (int column = 0; column < 3; column++) {
    for (int row = 0; row < 3; row++) out[3 * row + column] = rotation[3 * row + column] * scale[column];
  }
}

float base_colour(float sh0) { return float(0.5 + kShC0 * sh0); }

float log2_sigmoid(float logit) { return float(std::max(-std::log1p(std::exp(-double(logit))) * kLog2E, double(kInvisible))); }

}  // namespace

Scene::Scene(const CagsSplats& splats, int threads)
    : count_(int(splats.count)), padded_((count_ + kLanes - 1) / kLanes * kLanes), sh_rest_(splats.sh_rest_count) {
  float* planes = geometry_.reserve(size_t(kPlanes) * padded_);
  std::fill_n(planes, size_t(kPlanes) * padded_, 0.0f);
  std::fill(planes + size_t(kOpacity) * padded_ + count_, planes + size_t(kOpacity + 1) * padded_, kInvisible);
  std::fill_n(rest_.reserve(size_t(padded_) * sh_rest_ * 3), size_t(padded_) * sh_rest_ * 3, 0.0f);
  std::fill_n(tie_.reserve(padded_), padded_, 0u);
  std::fill_n(scale_.reserve(size_t(3) * padded_), size_t(3) * padded_, 0.0f);
  std::fill_n(logit_.reserve(padded_), padded_, NAN);  // no logit is equal to it
  std::fill_n(looks_.reserve(padded_), padded_, 0u);
  degree_.reserve(padded_ / kLanes);
  parallel_for(threads, (padded_ + kLoadChunk - 1) / kLoadChunk, [&](int chunk, int) {
    const int begin = chunk * kLoadChunk, end = std::min(begin + kLoadChunk, padded_);
    for (int i = begin; i < std::min(end, count_); i++) store(i, splats, i);
    for (int block = begin / kLanes; block < end / kLanes; block++) refresh_degree(block);
  });
}

void Scene::update(const int64_t* rows, int64_t count, const CagsSplats& all, int threads) {
  auto each = [&](const auto& change) {
    parallel_for(threads, int((count + kMoveChunk - 1) / kMoveChunk), [&](int chunk, int) {
      const int64_t begin = int64_t(chunk) * kMoveChunk, end = std::min(count, begin + kMoveChunk);
      for (int64_t i = begin; i < end; i++) change(i);
    });
  };
  each([&](int64_t i) { store(int(rows[i]), all, rows[i]); });
  if (sh_rest_ == 0) return;
  each([&](int64_t i) {  // rows rise: a block is looked at once
    const int64_t block = rows[i] / kLanes;
    if (i == 0 || block != rows[i - 1] / kLanes) refresh_degree(int(block));
  });
}

bool Scene::drawable(const int64_t* rows, int64_t count, const CagsSplats& all, int threads, bool looks) const {
  const int coefficients = 3 * sh_rest_;
  std::atomic<bool> good{true};
  parallel_for(threads, int((count + kMoveChunk - 1) / kMoveChunk), [&](int chunk, int) {
    bool fine = true;
    for (int64_t i = int64_t(chunk) * kMoveChunk; i < std::min(count, int64_t(chunk + 1) * kMoveChunk); i++) {
      const float *mean = all.means + 3 * rows[i], *quat = all.quats + 4 * rows[i];
      float sum = mean[0] * 0.0f + mean[1] * 0.0f + mean[2] * 0.0f + all.logit_opacities[rows[i]] * 0.0f;
      if (looks) {
        const float *scale = all.log_scales + 3 * rows[i], *sh0 = all.sh0 + 3 * rows[i];
        const float* rest = all.sh_rest + coefficients * rows[i];
        for (int k = 0; k < 3; k++) sum += scale[k] * 0.0f + sh0[k] * 0.0f;
        for (int k = 0; k < coefficients; k++) sum += rest[k] * 0.0f;
      }
      double norm = 0;
      for (int k = 0; k < 4; k++) norm += double(quat[k]) * quat[k];
      fine &= sum == 0.0f && norm >= kLeastNorm * kLeastNorm && norm < double(INFINITY);
    }
    if (!fine) good = false;
  });
  return good;
}

void Scene::move(const int64_t* rows, int64_t count, const CagsSplats& all, int threads) {
  parallel_for(threads, int((count + kMoveChunk - 1) / kMoveChunk), [&](int chunk, int) {
    const int64_t begin = int64_t(chunk) * kMoveChunk, end = std::min(count, begin + kMoveChunk);
    for (int64_t i = begin; i < end; i++) place(int(rows[i]), all, rows[i]);
  });
}

SceneData Scene::data() const {
  SceneData data{};
  auto plane = [&](int index) { return geometry_.data() + size_t(index) * padded_; };
  data.count = count_, data.padded = padded_, data.sh_rest = sh_rest_;
  for (int i = 0; i < 3; i++) data.mean[i] = plane(kMean + i), data.base[i] = plane(kBase + i);
  for (int i = 0; i < 9; i++) data.axes[i] = plane(kAxes + i);
  data.log2_opacity = plane(kOpacity);
  data.tie = tie_.data(), data.rest = rest_.data(), data.degree = degree_.data();
  return data;
}

void Scene::store(int slot, const CagsSplats& splats, int64_t row) {
  const float *log_scale = splats.log_scales + 3 * row, *sh0 = splats.sh0 + 3 * row;
  const int coefficients = 3 * sh_rest_;
  const float* rest = splats.sh_rest + row * coefficients;
  for (int i = 0; i < 3; i++) geometry_[size_t(kBase + i) * padded_ + slot] = base_colour(sh0[i]);
  float* block = rest_.data() + size_t(slot / kLanes) * coefficients * kLanes + slot % kLanes;
  for (int i = 0; i < coefficients; i++) block[size_t(i) * kLanes] = rest[i];
  for (int i = 0; i < 3; i++) scale_[size_t(3) * slot + i] = float(std::min(std::exp(double(log_scale[i])), kMaxScale));
  ContentHash hash;
  hash.add(log_scale, 3), hash.add(sh0, 3), hash.add(rest, coefficients);
  looks_[slot] = hash.state();
  place(slot, splats, row);
}

// Where a splat is, which way it points, how opaque it is, and its content's hash; not its colours.
void Scene::place(int slot, const CagsSplats& splats, int64_t row) {
  auto put = [&](int plane, double value) { geometry_[size_t(plane) * padded_ + slot] = float(value); };
  const float *mean = splats.means + 3 * row, *quat = splats.quats + 4 * row, *logit = splats.logit_opacities + row;
  double axes[9];
  scaled_axes(quat, scale_.data() + size_t(3) * slot, axes);
  for (int i = 0; i < 3; i++) put(kMean + i, mean[i]);
  for (int i = 0; i < 9; i++) put(kAxes + i, axes[i]);
  if (logit_[slot] != *logit) put(kOpacity, log2_sigmoid(*logit)), logit_[slot] = *logit;
  ContentHash hash(looks_[slot]);
  hash.add(mean, 3), hash.add(quat, 4), hash.add(logit, 1);
  tie_[slot] = hash.value();
}

void Scene::refresh_degree(int block) {
  constexpr int kFirstOfDegree[] = {0, 0, 3, 8, 15};
  const float* coefficients = rest_.data() + size_t(block) * sh_rest_ * 3 * kLanes;
  int degree = 0;
  for (int d = 3; d >= 1 && degree == 0; d--) {
    const int begin = kFirstOfDegree[d] * 3 * kLanes, end = std::min(kFirstOfDegree[d + 1], sh_rest_) * 3 * kLanes;
    for (int i = begin; i < end; i++) degree = coefficients[i] != 0.0f ? d : degree;
  }
  degree_[block] = uint8_t(degree);
}

}  // namespace cags::raster
