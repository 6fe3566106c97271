// Tiles at a time: doubles in the order of the numpy definition, so that both give the same bits.
#include "motion/cags_motion.h"
#include "support/guarded.h"
#include "support/thread_pool.h"

#include <algorithm>
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

// Samples [span + 1, count] at a time.
class Between {
 public:
  Between() = default;
  Between(const int32_t* samples, int64_t count, const CagsMotionTile& tile)
      : first_(samples + tile.sample * count), after_(first_ + count), share_(tile.share) {}

  // Those from `at` on.
  void take(int64_t at, int count, double* out) const {
    const int32_t *first = first_ + at, *after = after_ + at;
    if (share_ == 0.0) {
      for (int k = 0; k < count; k++) out[k] = first[k];
    } else {
      for (int k = 0; k < count; k++) out[k] = first[k] + (double(after[k]) - first[k]) * share_;
    }
  }

 private:
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
    for (first_ = first; first_ < end; first_ += kRun) {
      count_ = std::min(end - first_, kRun);
      gather();
      if (tile_.moves) shift();
      if (tile_.turns) turn();
      scatter();
    }
  }

 private:
  void gather() {
    for (int k = 0; k < count_; k++) {
      const int64_t row = tile_.rows[first_ + k];
      if (row < 0) continue;  // what is left here is worked on, and written nowhere
      const float *mean = arrays_.means + 3 * row, *quat = arrays_.quats + 4 * row;
      for (int axis = 0; axis < 3; axis++) means_[axis][k] = mean[axis];
      turned_.w[k] = quat[0], turned_.x[k] = quat[1], turned_.y[k] = quat[2], turned_.z[k] = quat[3];
    }
  }

  void shift() {
    moves_.take(3 * int64_t{first_}, 3 * count_, said_);
    for (int k = 0; k < count_; k++) {
      const double step = tile_.move_steps[first_ + k] / kFraction;
      for (int axis = 0; axis < 3; axis++) means_[axis][k] += said_[3 * k + axis] * step;
    }
  }

  void turn() {
    turns_.take(4 * int64_t{first_}, 4 * count_, said_);
    for (int k = 0; k < count_; k++) {
      const double step = tile_.turn_steps[first_ + k] / kFraction;
      turns_by_.w[k] = said_[4 * k] * step + 1.0, turns_by_.x[k] = said_[4 * k + 1] * step;
      turns_by_.y[k] = said_[4 * k + 2] * step, turns_by_.z[k] = said_[4 * k + 3] * step;
    }
    make_unit(turns_by_, count_);
    multiply(turns_by_, turned_, count_);
    make_unit(turned_, count_);
  }

  void scatter() const {
    for (int k = 0; k < count_; k++) {
      const int64_t row = tile_.rows[first_ + k];
      if (row < 0) continue;
      for (int axis = 0; axis < 3; axis++) arrays_.into_means[3 * row + axis] = static_cast<float>(means_[axis][k]);
      if (tile_.turns)
        write_turned(k, arrays_.into_quats + 4 * row);
      else
        std::copy_n(arrays_.quats + 4 * row, 4, arrays_.into_quats + 4 * row);
      if (!tile_.fades) arrays_.into_logits[row] = there(first_ + k) ? arrays_.logits[row] : kAbsentLogit;
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
  int first_ = 0, count_ = 0;  // of the run
  Column means_[3] = {};
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
