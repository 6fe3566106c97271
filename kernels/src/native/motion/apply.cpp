// Tiles at a time: doubles in the order of the numpy definition, so that both give the same bits.
#include "motion/cags_motion.h"
#include "support/guarded.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <iterator>
#include <limits>
#include <vector>

namespace cags::motion {
namespace {

constexpr int kPiece = 2048;  // splats a piece of work
constexpr double kFraction = 64.0;
constexpr float kAbsentLogit = -30.0f;
constexpr int64_t kMostRows = std::numeric_limits<int32_t>::max();  // rows are named by 32 bits

// Of the splats of a run, one after the other in a tile: every loop over them does one thing, so that compilers make
// vectors of it, and divisions and roots of neighbours overlap. Each splat's bits are those of one alone.
constexpr int kRun = 64;
using Column = double[kRun];

struct Quats {
  Column w, x, y, z;
};

void make_unit(Quats& q, int count) {
  for (int k = 0; k < count; k++) {
    const double norm = std::sqrt(((q.w[k] * q.w[k] + q.x[k] * q.x[k]) + q.y[k] * q.y[k]) + q.z[k] * q.z[k]);
    const bool sound = (norm > 1e-12) & (norm < std::numeric_limits<double>::infinity());
    q.w[k] = sound ? q.w[k] / norm : 1.0, q.x[k] = sound ? q.x[k] / norm : 0.0;
    q.y[k] = sound ? q.y[k] / norm : 0.0, q.z[k] = sound ? q.z[k] / norm : 0.0;
  }
}

// b becomes a b.
void multiply(const Quats& a, Quats& b, int count) {
  for (int k = 0; k < count; k++) {
    const double w = b.w[k], x = b.x[k], y = b.y[k], z = b.z[k];
    b.w[k] = ((a.w[k] * w - a.x[k] * x) - a.y[k] * y) - a.z[k] * z,
    b.x[k] = ((a.w[k] * x + a.x[k] * w) + a.y[k] * z) - a.z[k] * y;
    b.y[k] = ((a.w[k] * y - a.x[k] * z) + a.y[k] * w) + a.z[k] * x,
    b.z[k] = ((a.w[k] * z + a.x[k] * y) - a.y[k] * x) + a.z[k] * w;
  }
}

double held(double value, double least, double most) { return value < least ? least : value > most ? most : value; }

template <size_t kTerms>
double polynomial(const double (&coefficients)[kTerms], double at) {
  double out = coefficients[0];
  for (size_t i = 1; i < kTerms; i++) out = out * at + coefficients[i];
  return out;
}

// Exponential and logarithm of cags_common.motion.fades, to the same bits.
constexpr double kFaintest = 1e-9, kStrongest = 1 - 1e-7;
constexpr double kLn2[] = {0.693147180369123816490, 1.90821492927058770002e-10};
constexpr int64_t kOne = std::bit_cast<int64_t>(1.0);

double exponential(double value) {
  constexpr double kMost = 700.0, kLog2E = 1.4426950408889634, kRound = 6755399441055744.0;
  constexpr double kTaylor[] = {1.0 / 479001600, 1.0 / 39916800, 1.0 / 3628800, 1.0 / 362880, 1.0 / 40320, 1.0 / 5040, 1.0 / 720,
                                1.0 / 120,       1.0 / 24,       1.0 / 6,       1.0 / 2,      1.0,         1.0};
  value = held(value, -kMost, kMost);
  const double rounded = value * kLog2E + kRound, power = rounded - kRound;
  const double rest = (value - power * kLn2[0]) - power * kLn2[1];
  const uint64_t scale = (std::bit_cast<uint64_t>(rounded) << 52) + kOne;  // 2 to the power
  return polynomial(kTaylor, rest) * std::bit_cast<double>(scale);
}

double logarithm(double value) {
  constexpr double kOdd[] = {1.0 / 21, 1.0 / 19, 1.0 / 17, 1.0 / 15, 1.0 / 13, 1.0 / 11, 1.0 / 9, 1.0 / 7, 1.0 / 5, 1.0 / 3, 1.0};
  constexpr double kHalfRoot = 0.7071067811865476;
  constexpr int64_t kFraction52 = (int64_t{1} << 52) - 1, kHalf = std::bit_cast<int64_t>(0.5);
  const int64_t bits = std::bit_cast<int64_t>(value);
  double part = std::bit_cast<double>((bits & kFraction52) | kHalf);
  const bool small = part < kHalfRoot;
  const double power = static_cast<int32_t>(bits >> 52) - 1022 - small;
  part = small ? 2.0 * part : part;
  const double way = (part - 1.0) / (part + 1.0);
  const double series = 2.0 * way * polynomial(kOdd, way * way);
  return power * kLn2[0] + (power * kLn2[1] + series);
}

// Samples [span + 1, count] at a time.
class Between {
 public:
  Between() = default;
  Between(const int32_t* samples, int64_t count, const CagsMotionTile& tile)
      : first_(samples + tile.sample * count), after_(first_ + count), share_(tile.share) {}

  // `parts` of each of the `splats`, which rise: one after the other where they are neighbours.
  void take(const int* splats, int count, int parts, double* out) const {
    if (splats[count - 1] - splats[0] == count - 1) return line(int64_t{parts} * splats[0], parts * count, out);
    for (int k = 0; k < count; k++) line(int64_t{parts} * splats[k], parts, out + parts * k);
  }

 private:
  void line(int64_t at, int count, double* out) const {
    const int32_t *first = first_ + at, *after = after_ + at;
    if (share_ == 0.0) {
      for (int k = 0; k < count; k++) out[k] = first[k];
    } else {
      for (int k = 0; k < count; k++) out[k] = first[k] + (double(after[k]) - first[k]) * share_;
    }
  }

  const int32_t *first_ = nullptr, *after_ = nullptr;
  double share_ = 0.0;
};

class Mover {
 public:
  Mover(const CagsMotionTile& tile, const CagsMotionArrays& arrays) : tile_(tile), arrays_(arrays) {
    if (tile.moves) moves_ = Between(tile.moves, int64_t{3} * tile.splats, tile);
    if (tile.turns) turns_ = Between(tile.turns, int64_t{4} * tile.splats, tile);
  }

  void run(int first, int end) {
    while (first < end) {
      for (count_ = 0; first < end && count_ < kRun; first++) {
        if (tile_.rows[first] >= 0) splats_[count_++] = first;
      }
      if (!count_) return;
      gather();
      if (tile_.moves) shift();
      if (tile_.turns) turn();
      if (tile_.fades) fade();
      scatter();
    }
  }

 private:
  void gather() {
    for (int k = 0; k < count_; k++) {
      const int64_t row = tile_.rows[splats_[k]];
      const float *mean = arrays_.means + 3 * row, *quat = arrays_.quats + 4 * row;
      for (int axis = 0; axis < 3; axis++) means_[axis][k] = mean[axis];
      logits_[k] = arrays_.logits[row];
      turned_.w[k] = quat[0], turned_.x[k] = quat[1], turned_.y[k] = quat[2], turned_.z[k] = quat[3];
    }
  }

  void shift() {
    say(moves_, tile_.moves, 3);
    for (int k = 0; k < count_; k++) {
      const double step = tile_.move_steps[splats_[k]] / kFraction;
      for (int axis = 0; axis < 3; axis++) means_[axis][k] += said_[3 * k + axis] * step;
    }
  }

  void turn() {
    say(turns_, tile_.turns, 4);
    for (int k = 0; k < count_; k++) {
      const double step = tile_.turn_steps[splats_[k]] / kFraction;
      turns_by_.w[k] = said_[4 * k] * step + 1.0, turns_by_.x[k] = said_[4 * k + 1] * step;
      turns_by_.y[k] = said_[4 * k + 2] * step, turns_by_.z[k] = said_[4 * k + 3] * step;
    }
    make_unit(turns_by_, count_);
    multiply(turns_by_, turned_, count_);
    make_unit(turned_, count_);
  }

  // What the samples say at the time; of splats that have ended, at their end.
  void say(const Between& between, const int32_t* samples, int parts) {
    between.take(splats_, count_, parts, said_);
    if (!tile_.lives) return;
    for (int k = 0; k < count_; k++) {
      const int i = splats_[k];
      if (!there(i)) std::copy_n(samples + parts * (int64_t{tile_.lives[i]} * tile_.splats + i), parts, said_ + parts * k);
    }
  }

  void fade() {
    Column away, gaussian, visible, odds;
    for (int k = 0; k < count_; k++) {
      const float* fade = tile_.fades + 2 * splats_[k];
      away[k] = (tile_.time - fade[0]) / double{fade[1]};
    }
    for (int k = 0; k < count_; k++) gaussian[k] = exponential(-0.5 * away[k] * away[k]);
    for (int k = 0; k < count_; k++) visible[k] = exponential(-double{logits_[k]});
    for (int k = 0; k < count_; k++) {
      const double opacity = gaussian[k] / (1.0 + visible[k]), inside = held(opacity, kFaintest, kStrongest);
      odds[k] = inside / (1.0 - inside);
    }
    for (int k = 0; k < count_; k++) odds[k] = logarithm(odds[k]);
    for (int k = 0; k < count_; k++) {
      const bool fades = tile_.fades[2 * splats_[k] + 1] < std::numeric_limits<float>::infinity();
      logits_[k] = fades ? static_cast<float>(odds[k]) : logits_[k];
    }
  }

  void scatter() const {
    for (int k = 0; k < count_; k++) {
      const int64_t row = tile_.rows[splats_[k]];
      for (int axis = 0; axis < 3; axis++) arrays_.into_means[3 * row + axis] = static_cast<float>(means_[axis][k]);
      if (tile_.turns)
        write_turned(k, arrays_.into_quats + 4 * row);
      else
        std::copy_n(arrays_.quats + 4 * row, 4, arrays_.into_quats + 4 * row);
      arrays_.into_logits[row] = there(splats_[k]) ? logits_[k] : kAbsentLogit;
    }
  }

  void write_turned(int k, float* out) const {
    const double sign = turned_.w[k] < 0 ? -1.0 : 1.0;
    out[0] = static_cast<float>(sign * turned_.w[k]), out[1] = static_cast<float>(sign * turned_.x[k]);
    out[2] = static_cast<float>(sign * turned_.y[k]), out[3] = static_cast<float>(sign * turned_.z[k]);
  }

  bool there(int i) const { return !tile_.lives || tile_.lives[i] > tile_.time || tile_.lives[i] == tile_.span + 1; }

  const CagsMotionTile& tile_;
  const CagsMotionArrays& arrays_;
  Between moves_, turns_;
  int splats_[kRun];  // of the run, rising
  int count_ = 0;
  Column means_[3] = {};
  float logits_[kRun];
  Quats turned_ = {}, turns_by_;
  double said_[4 * kRun];
};

// Whether each array is of its size, or not there.
bool fits(const CagsMotionTile& tile) {
  const int64_t splats = tile.splats, samples = tile.span + 1;
  const struct {
    const void* array;
    int64_t wanted;
  } arrays[] = {
      {tile.rows, splats},       {tile.moves, 3 * splats * samples}, {tile.turns, 4 * splats * samples},
      {tile.move_steps, splats}, {tile.turn_steps, splats},          {tile.lives, splats},
      {tile.fades, 2 * splats},
  };
  static_assert(std::size(arrays) == std::size(CagsMotionTile{}.lengths));
  for (size_t i = 0; i < std::size(arrays); i++) {
    if (tile.lengths[i] != (arrays[i].array ? arrays[i].wanted : 0)) return false;
  }
  return tile.rows || !splats;
}

bool fits(const CagsMotionArrays& arrays) {
  const int64_t wanted[] = {3 * arrays.capacity, 4 * arrays.capacity, arrays.capacity};
  return arrays.capacity >= 0 && arrays.capacity <= kMostRows && std::equal(wanted, wanted + 3, arrays.lengths) &&
         std::equal(wanted, wanted + 3, arrays.lengths + 3);
}

bool valid(const CagsMotionTile& tile, int64_t capacity) {
  auto within = [](int32_t value, int32_t least, int32_t most) { return least <= value && value <= most; };
  if (!within(tile.splats, 0, CAGS_MAX_TILE_SPLATS) || !within(tile.span, 1, CAGS_MAX_SPAN)) return false;
  if (!within(tile.sample, 0, tile.span - 1) || !fits(tile)) return false;
  if (!(tile.time >= 0.0 && tile.time <= tile.span) || !(tile.share >= 0.0 && tile.share <= 1.0)) return false;
  if ((tile.moves && !tile.move_steps) || (tile.turns && !tile.turn_steps)) return false;
  int32_t least = 0, most = -1;
  for (int i = 0; i < tile.splats; i++) least = std::min(least, tile.rows[i]), most = std::max(most, tile.rows[i]);
  return least >= -1 && most < capacity;
}

struct Piece {
  const CagsMotionTile* tile;
  int first, end;
};

}  // namespace
}  // namespace cags::motion

int32_t cags_motion_rows(const CagsMotionTile* tiles, int32_t count, const CagsMotionArrays* arrays, int32_t threads) {
  using namespace cags::motion;
  if (count < 0 || threads < 1 || !fits(*arrays)) return CAGS_INVALID;
  for (int i = 0; i < count; i++) {
    if (!valid(tiles[i], arrays->capacity)) return CAGS_INVALID;
  }
  return cags::guarded([&] {
    std::vector<Piece> pieces;
    for (const CagsMotionTile* tile = tiles; tile < tiles + count; tile++) {
      for (int at = 0; at < tile->splats; at += kPiece) pieces.push_back({tile, at, std::min(at + kPiece, tile->splats)});
    }
    cags::parallel_for(std::min(threads, cags::kMaxThreads), static_cast<int>(pieces.size()), [&](int index, int) {
      const Piece& piece = pieces[index];
      Mover(*piece.tile, *arrays).run(piece.first, piece.end);
    });
  });
}
