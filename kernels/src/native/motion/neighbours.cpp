// Neighbours of the splats of a tile: see cags_common.motion.neighbours, which gives the same bits.
#include "motion/neighbours.h"

#include "motion/cags_motion.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace cags::motion {
namespace {

constexpr int kWindow = 16, kCount = CAGS_NEIGHBOURS;
constexpr double kTiny = 1e-30, kRidge = 0.1, kFurthest = 64.0;

struct Place {
  double x, y, z;
};

Place away(const float* from, const float* to) {
  return {double(to[0]) - from[0], double(to[1]) - from[1], double(to[2]) - from[2]};
}

// The nearest of what it was shown, the first of those at one distance.
struct Nearest {
  static constexpr double kFar = std::numeric_limits<double>::infinity();
  double squared[kCount];
  int32_t rows[kCount];

  Nearest() { std::fill_n(squared, kCount, kFar); }

  void show(int32_t row, double distance) {
    if (!(distance < squared[kCount - 1])) return;
    int at = kCount - 1;
    for (; at > 0 && distance < squared[at - 1]; at--) squared[at] = squared[at - 1], rows[at] = rows[at - 1];
    squared[at] = distance, rows[at] = row;
  }
};

// The sum of value(k) over the neighbours, from the first on.
template <typename Value>
double total(const Value& value) {
  double sum = value(0);
  for (int k = 1; k < kCount; k++) sum = sum + value(k);
  return sum;
}

// Shares of the neighbours; those that are missing become the splat itself, with none.
void share(const float* units, int32_t self, Nearest& nearest, double* shares, double* distances) {
  const double finest = double(units[self]) + kTiny, closest = std::sqrt(nearest.squared[0]) + kTiny;
  double weights[kCount];
  for (int k = 0; k < kCount; k++) {
    const bool missing = std::isinf(nearest.squared[k]);
    if (missing) nearest.rows[k] = self;
    distances[k] = missing ? 0.0 : std::sqrt(nearest.squared[k]);
    const double weight = closest / (distances[k] + kTiny) * (finest / (double(units[nearest.rows[k]]) + kTiny));
    weights[k] = missing ? 0.0 : weight;
  }
  const double all = total([&](int k) { return weights[k]; });
  for (int k = 0; k < kCount; k++) shares[k] = weights[k] / all;
}

void fit(const double* shares, const Place* places, double mean, float* out) {
  double place[3][kCount], off[3][kCount], middle[3], spread[3][3];
  for (int k = 0; k < kCount; k++) {
    const double scale = mean + kTiny;
    place[0][k] = places[k].x / scale, place[1][k] = places[k].y / scale, place[2][k] = places[k].z / scale;
  }
  for (int a = 0; a < 3; a++) {
    middle[a] = total([&](int k) { return shares[k] * place[a][k]; });
    for (int k = 0; k < kCount; k++) off[a][k] = place[a][k] - middle[a];
  }
  for (int a = 0; a < 3; a++) {
    for (int b = 0; b <= a; b++) {
      spread[a][b] = spread[b][a] = total([&](int k) { return shares[k] * (off[a][k] * off[b][k]); });
    }
  }
  const double xx = spread[0][0] + kRidge, yy = spread[1][1] + kRidge, zz = spread[2][2] + kRidge;
  const double xy = spread[0][1], xz = spread[0][2], yz = spread[1][2];
  const double inverse[3][3] = {
      {yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy},
      {xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz},
      {xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy},
  };
  const double size = (xx * inverse[0][0] + xy * inverse[0][1]) + xz * inverse[0][2];
  for (int k = 0; k < kCount; k++, out += CAGS_FIT) {
    double slopes[3];
    for (int a = 0; a < 3; a++) {
      const double* row = inverse[a];
      slopes[a] = shares[k] * (((row[0] * off[0][k] + row[1] * off[1][k]) + row[2] * off[2][k]) / size);
      out[1 + a] = static_cast<float>(place[a][k]), out[4 + a] = static_cast<float>(slopes[a]);
    }
    out[0] = static_cast<float>(shares[k]);
    out[7] = static_cast<float>(shares[k] - ((middle[0] * slopes[0] + middle[1] * slopes[1]) + middle[2] * slopes[2]));
  }
}

void find(const float* positions, const float* units, const Group& group, int k, int last, int32_t* rows, float* fits) {
  const int32_t self = group.splat(k);
  Nearest nearest;
  const int end = std::min(k + kWindow, last);
  for (int at = std::max(0, k + 1 - kWindow); at <= end; at++) {
    const Place place = away(positions + 3 * self, positions + 3 * at * group.step);
    nearest.show(at * group.step, (place.x * place.x + place.y * place.y) + place.z * place.z);
  }
  double shares[kCount], distances[kCount];
  Place places[kCount];
  share(units, self, nearest, shares, distances);
  for (int n = 0; n < kCount; n++) rows[n] = nearest.rows[n], places[n] = away(positions + 3 * self, positions + 3 * rows[n]);
  const double mean = total([&](int n) { return shares[n] * distances[n]; });
  fit(shares, places, std::max(mean, *std::max_element(distances, distances + kCount) / kFurthest), fits);
}

bool finite(const float* numbers, int64_t count) {
  return std::all_of(numbers, numbers + count, [](float x) { return std::isfinite(x); });
}

}  // namespace
}  // namespace cags::motion

int32_t cags_motion_neighbours(const float* positions, int64_t positions_length, const float* units, int64_t units_length,
                               int32_t* neighbours, int64_t neighbours_length, float* fits, int64_t fits_length) {
  using namespace cags::motion;
  const int64_t splats = units_length, each = splats * kCount;
  if (splats < 0 || splats > CAGS_MAX_TILE_SPLATS || positions_length != 3 * splats) return CAGS_INVALID;
  if (neighbours_length != each || fits_length != each * CAGS_FIT) return CAGS_INVALID;
  if (!finite(positions, positions_length) || !finite(units, units_length)) return CAGS_INVALID;
  for (int index = 0; index < kGroups; index++) {
    const Group group(index, static_cast<int>(splats));
    const int last = static_cast<int>(splats - 1) / group.step;
    for (int k = 0; k < group.count; k++) {
      const int64_t first = int64_t{kCount} * group.splat(k);
      if (group.between) {
        find(positions, units, group, k, last, neighbours + first, fits + first * CAGS_FIT);
      } else {
        std::fill_n(neighbours + first, kCount, group.splat(k)), std::fill_n(fits + first * CAGS_FIT, kCount * CAGS_FIT, 0.0f);
      }
    }
  }
  return CAGS_OK;
}
