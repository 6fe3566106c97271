// Tiles at a time: doubles in the order of the numpy definition, so that both give the same bits.
#include "motion/cags_motion.h"
#include "support/guarded.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace cags::motion {
namespace {

constexpr int kPiece = 2048;  // splats a piece of work
constexpr double kFraction = 64.0, kTurnUnit = 1.0 / 4096;
constexpr float kAbsentLogit = -30.0f;

struct Quat {
  double w, x, y, z;
};

Quat unit(const Quat& q) {
  const double norm = std::sqrt(((q.w * q.w + q.x * q.x) + q.y * q.y) + q.z * q.z);
  if (!(norm > 1e-12) || !std::isfinite(norm)) return {1.0, 0.0, 0.0, 0.0};
  return {q.w / norm, q.x / norm, q.y / norm, q.z / norm};
}

Quat product(const Quat& a, const Quat& b) {
  return {((a.w * b.w - a.x * b.x) - a.y * b.y) - a.z * b.z, ((a.w * b.x + a.x * b.w) + a.y * b.z) - a.z * b.y,
          ((a.w * b.y - a.x * b.z) + a.y * b.w) + a.z * b.x, ((a.w * b.z + a.x * b.y) - a.y * b.x) + a.z * b.w};
}

void rotate(const Quat& q, double* p) {
  const double cx = q.y * p[2] - q.z * p[1], cy = q.z * p[0] - q.x * p[2], cz = q.x * p[1] - q.y * p[0];
  p[0] = p[0] + 2.0 * (q.w * cx + (q.y * cz - q.z * cy));
  p[1] = p[1] + 2.0 * (q.w * cy + (q.z * cx - q.x * cz));
  p[2] = p[2] + 2.0 * (q.w * cz + (q.x * cy - q.y * cx));
}

// Samples [span + 1, count] at a time.
class Between {
 public:
  Between() = default;
  Between(const int32_t* samples, int64_t count, const CagsMotionTile& tile)
      : first_(samples + tile.sample * count), after_(first_ + count), share_(tile.share) {}
  double operator[](int64_t i) const {
    const double first = first_[i];
    return share_ == 0.0 ? first : first + (after_[i] - first) * share_;
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
    if (!tile.block) return;
    const int64_t blocks = (tile.splats + tile.block - 1) / tile.block;
    block_shifts_ = Between(tile.block_shifts, 3 * blocks, tile), block_turns_ = Between(tile.block_turns, 3 * blocks, tile);
  }

  void run(int first, int end) {
    for (int i = first; i < end; i++) {
      if (tile_.block && (i == first || i % tile_.block == 0)) enter(i / tile_.block);
      if (tile_.rows[i] >= 0) move(i, tile_.rows[i]);
    }
  }

 private:
  void enter(int64_t block) {
    const int64_t at = 3 * block;
    block_turn_ = unit({1.0, block_turns_[at] * kTurnUnit, block_turns_[at + 1] * kTurnUnit, block_turns_[at + 2] * kTurnUnit});
    for (int axis = 0; axis < 3; axis++) block_shift_[axis] = block_shifts_[at + axis] * tile_.block_unit;
  }

  void move(int i, int64_t row) const {
    const float *mean = arrays_.means + 3 * row, *quat = arrays_.quats + 4 * row;
    double p[3] = {mean[0], mean[1], mean[2]};
    Quat turned{quat[0], quat[1], quat[2], quat[3]};
    if (tile_.block) {
      rotate(block_turn_, p);
      for (int axis = 0; axis < 3; axis++) p[axis] += block_shift_[axis];
      turned = product(block_turn_, turned);
    }
    if (tile_.moves) {
      const double step = tile_.move_steps[i] / kFraction;
      for (int axis = 0; axis < 3; axis++) p[axis] += moves_[3 * int64_t{i} + axis] * step;
    }
    if (tile_.turns) {
      const double step = tile_.turn_steps[i] / kFraction;
      const int64_t at = 4 * int64_t{i};
      turned =
          product(unit({turns_[at] * step + 1.0, turns_[at + 1] * step, turns_[at + 2] * step, turns_[at + 3] * step}), turned);
    }
    for (int axis = 0; axis < 3; axis++) arrays_.into_means[3 * row + axis] = static_cast<float>(p[axis]);
    write_turned(turned, quat, arrays_.into_quats + 4 * row);
    if (!tile_.fades) arrays_.into_logits[row] = there(i) ? arrays_.logits[row] : kAbsentLogit;
  }

  void write_turned(const Quat& turned, const float* before, float* out) const {
    if (!tile_.block && !tile_.turns) {
      std::copy_n(before, 4, out);
      return;
    }
    const Quat q = unit(turned);
    const bool turn = q.w < 0;
    out[0] = static_cast<float>(turn ? -q.w : q.w), out[1] = static_cast<float>(turn ? -q.x : q.x);
    out[2] = static_cast<float>(turn ? -q.y : q.y), out[3] = static_cast<float>(turn ? -q.z : q.z);
  }

  bool there(int i) const { return !tile_.lives || tile_.lives[i] > tile_.time || tile_.lives[i] == tile_.span + 1; }

  const CagsMotionTile& tile_;
  const CagsMotionArrays& arrays_;
  Between moves_, turns_, block_shifts_, block_turns_;
  Quat block_turn_{};
  double block_shift_[3] = {};
};

bool valid(const CagsMotionTile& tile, int64_t capacity) {
  if (tile.splats < 0 || tile.span < 1 || tile.sample < 0 || tile.sample >= tile.span || tile.block < 0) return false;
  if (!(tile.time >= 0.0 && tile.time <= tile.span) || !(tile.share >= 0.0 && tile.share <= 1.0)) return false;
  if ((tile.moves && !tile.move_steps) || (tile.turns && !tile.turn_steps)) return false;
  if (tile.block && (!tile.block_shifts || !tile.block_turns)) return false;
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
  if (count < 0 || threads < 1 || arrays->capacity < 0) return CAGS_INVALID;
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
