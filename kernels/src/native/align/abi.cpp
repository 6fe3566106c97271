#include "align/cags_align.h"
#include "align/erode.h"
#include "align/stages.h"
#include "support/aligned.h"
#include "support/instruction_set.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <mutex>
#include <new>
#include <vector>

namespace cags::align {
namespace {

constexpr int kMaxSide = 16384;  // pixels
constexpr int kMaxRadius = 64;
constexpr int kRowsAPiece = 16;

const Stages& stages() {
  switch (active_instruction_set()) {
#ifdef CAGS_X86
    case InstructionSet::avx512: return stages_avx512;
    case InstructionSet::avx2: return stages_avx2;
#endif
    default: return stages_portable;
  }
}

// Memory of one call, kept for the next one: fresh pages cost more than the work on them.
struct Scratch {
  AlignedArray<float> z, reference, sums, fields, lines;
  AlignedArray<uint8_t> state, occluder, shared;
  AlignedArray<Nearest> nearest;
};

class ScratchLease {
 public:
  ScratchLease() {
    std::lock_guard lock(mutex());
    if (idle().empty()) {
      scratch_ = std::make_unique<Scratch>();
    } else {
      scratch_ = std::move(idle().back());
      idle().pop_back();
    }
  }
  ~ScratchLease() {
    std::lock_guard lock(mutex());
    idle().push_back(std::move(scratch_));
  }
  ScratchLease(const ScratchLease&) = delete;
  ScratchLease& operator=(const ScratchLease&) = delete;
  Scratch* operator->() const { return scratch_.get(); }

 private:
  static std::mutex& mutex() {
    static std::mutex instance;
    return instance;
  }
  static std::vector<std::unique_ptr<Scratch>>& idle() {
    static auto* instance = new std::vector<std::unique_ptr<Scratch>>;  // never destroyed: see Pool
    return *instance;
  }
  std::unique_ptr<Scratch> scratch_;
};

template <typename Body>
void for_rows(int threads, int rows, const Body& body) {
  parallel_for(threads, (rows + kRowsAPiece - 1) / kRowsAPiece, [&](int piece, int worker) {
    const int end = std::min(rows, (piece + 1) * kRowsAPiece);
    for (int row = piece * kRowsAPiece; row < end; row++) body(row, worker);
  });
}

bool side(int value) { return value >= 1 && value <= kMaxSide; }

Padded padded_colours(const CagsAlignInput& in, AlignedArray<float>& memory) {
  const int w = in.reference_width, h = in.reference_height;
  Padded out{memory.reserve(size_t(w + 2) * (h + 2) * kColourLanes), w, h};
  float* to = out.data;
  for (int row = -1; row <= h; row++) {
    const float* from = in.reference + int64_t{std::clamp(row, 0, h - 1)} * w * 3;
    for (int column = -1; column <= w; column++, to += kColourLanes) {
      const float* pixel = from + 3 * std::clamp(column, 0, w - 1);
      to[0] = pixel[0], to[1] = pixel[1], to[2] = pixel[2], to[3] = 0.0f;
    }
  }
  return out;
}

// The smaller of the steps to the two neighbours `step` apart; a void neighbour or the picture's edge does not count.
float slope(const float* depth, int64_t pixel, int64_t step, bool has_before, bool has_after) {
  const auto known = [&](int64_t i) { return depth[i] > 0 && std::isfinite(depth[i]); };
  float smallest = INFINITY;
  if (has_before && known(pixel - step)) smallest = std::fabs(depth[pixel] - depth[pixel - step]);
  if (has_after && known(pixel + step)) smallest = std::min(smallest, std::fabs(depth[pixel + step] - depth[pixel]));
  return std::isfinite(smallest) ? smallest : 0.0f;
}

class Alignment {
 public:
  Alignment(const CagsAlignInput& in, const CagsAlignOutput& out)
      : in_(in), out_(out), threads_(std::min(in.threads, kMaxThreads)), cells_(size_t(in.reference_width + 1) * (in.reference_height + 1)) {
    const size_t pixels = size_t(in.width) * in.height;
    scratch_->z.reserve(pixels);
    scratch_->state.reserve(pixels);
    scratch_->nearest.reserve(cells_ * threads_);
    scratch_->shared.reserve(cells_);
  }

  void run() {
    std::fill_n(scratch_->nearest.data(), cells_ * threads_, kNobody);
    for_rows(threads_, in_.height, [&](int row, int worker) {
      stages().project(in_, out_, row, scratch_->z.data(), scratch_->state.data(), scratch_->nearest.data() + cells_ * worker);
    });
    merge_nearest();
    find_occluded();
    if (!out_.rgb) return;
    const Padded reference = padded_colours(in_, scratch_->reference);
    for_rows(threads_, in_.height, [&](int row, int) { stages().sample(in_, out_, reference, scratch_->state.data(), row); });
    if (in_.erosion_radius > 0 && in_.erosion_iterations > 0) fill();
  }

 private:
  int cell_of(int64_t pixel) const {
    return static_cast<int>(out_.y[pixel]) * (in_.reference_width + 1) + static_cast<int>(out_.x[pixel]);
  }

  void merge_nearest() {
    Nearest* nearest = scratch_->nearest.data();
    for (int worker = 1; worker < threads_; worker++) {
      const Nearest* other = nearest + cells_ * worker;
      for (size_t i = 0; i < cells_; i++) nearest[i] = std::min(nearest[i], other[i]);
    }
  }

  void find_occluded() {
    std::vector<std::vector<int64_t>> found(threads_);
    for_rows(threads_, in_.height, [&](int row, int worker) { mark_row(row, found[worker]); });
    holes_.clear();
    for (auto& part : found) holes_.insert(holes_.end(), part.begin(), part.end());
  }

  void mark_row(int row, std::vector<int64_t>& found) {
    const float tolerance = 1.0f + in_.depth_tolerance, fade = 1.0f / std::max(in_.border_px, 1e-6f);
    const float w = static_cast<float>(in_.reference_width), h = static_cast<float>(in_.reference_height);
    uint8_t* state = scratch_->state.data();
    const float* z = scratch_->z.data();
    const Nearest* nearest = scratch_->nearest.data();
    for (int64_t i = int64_t{row} * in_.width; i < (int64_t{row} + 1) * in_.width; i++) {
      out_.occluded[i] = 0;
      out_.confidence[i] = 0.0f;
      if (state[i] == kOutside) continue;
      const Nearest first = nearest[cell_of(i)];
      float first_z;
      const uint32_t bits = static_cast<uint32_t>(first >> 32);
      std::memcpy(&first_z, &bits, sizeof first_z);
      if (z[i] > first_z * tolerance && hidden(i, row, first_z * tolerance, static_cast<uint32_t>(first))) {
        out_.occluded[i] = 1;
        state[i] = kOccluded;
        found.push_back(i);
        continue;
      }
      const float x = out_.x[i], y = out_.y[i];
      const float distance = std::min(std::min(x, w - x), std::min(y, h - y));
      out_.confidence[i] = std::min(std::max(distance * fade, 0.0f), 1.0f);
    }
  }

  // Behind even by the surface's own slope, and not within one reference pixel of the nearest in the client's view too.
  bool hidden(int64_t pixel, int row, float limit, uint32_t first) const {
    const int column = static_cast<int>(pixel - int64_t{row} * in_.width);
    const int rows_away = std::abs(row - static_cast<int>(first / in_.width));
    const int columns_away = std::abs(column - static_cast<int>(first % in_.width));
    if (columns_away <= in_.cell_x && rows_away <= in_.cell_y) return false;
    const float across = slope(in_.depth, pixel, 1, column > 0, column + 1 < in_.width);
    const float down = slope(in_.depth, pixel, in_.width, row > 0, row + 1 < in_.height);
    return scratch_->z[pixel] > limit + in_.slope_cells * (in_.cell_x * across + in_.cell_y * down);
  }

  void fill() {
    if (holes_.empty()) return;
    uint8_t* shared = scratch_->shared.data();
    std::fill_n(shared, cells_, uint8_t{0});
    for (int64_t pixel : holes_) shared[cell_of(pixel)] = 1;
    uint8_t* occluder = scratch_->occluder.reserve(size_t(in_.width) * in_.height);
    const uint8_t* state = scratch_->state.data();
    for_rows(threads_, in_.height, [&](int row, int) {
      for (int64_t i = int64_t{row} * in_.width; i < (int64_t{row} + 1) * in_.width; i++) {
        occluder[i] = state[i] == kSeen && shared[cell_of(i)];
      }
    });
    erode({in_.width, in_.height, in_.erosion_radius, in_.erosion_iterations, threads_, occluder}, std::move(holes_),
          scratch_->state.data(), out_.rgb);
  }

  const CagsAlignInput& in_;
  const CagsAlignOutput& out_;
  const int threads_;
  const size_t cells_;
  ScratchLease scratch_;
  std::vector<int64_t> holes_;
};

void correct(const CagsCorrectInput& in, float* restored) {
  ScratchLease scratch;
  const int w = in.reference_width, h = in.reference_height, threads = std::min(in.threads, kMaxThreads);
  const size_t line = size_t(w + 2 * in.radius_cells) * kMomentLanes;
  float* lines = scratch->lines.reserve(line * threads);
  float* sums = scratch->sums.reserve(size_t(w) * h * kMomentLanes);
  const size_t stride = size_t(w + 2) * kFieldLanes;
  const Padded fields{scratch->fields.reserve(stride * (h + 2)), w, h};
  for_rows(threads, h, [&](int row, int worker) { stages().moments(in, row, lines + line * worker, sums); });
  for_rows(threads, h, [&](int row, int) { stages().fit(in, row, sums, fields); });
  std::copy_n(fields.data + stride, stride, fields.data);
  std::copy_n(fields.data + stride * h, stride, fields.data + stride * (h + 1));
  for_rows(threads, in.height, [&](int row, int) { stages().correct(in, fields, row, restored); });
}

template <typename Body>
int32_t guarded(const Body& body) {
  try {
    body();
    return CAGS_OK;
  } catch (const std::bad_alloc&) {
    return CAGS_OUT_OF_MEMORY;
  } catch (...) {
    return CAGS_FAILED;
  }
}

}  // namespace
}  // namespace cags::align

int32_t cags_align(const CagsAlignInput* input, const CagsAlignOutput* output) {
  using namespace cags::align;
  const CagsAlignInput& in = *input;
  if (!side(in.width) || !side(in.height) || !side(in.reference_width) || !side(in.reference_height) || in.threads < 1 ||
      in.erosion_radius < 0 || in.erosion_radius > kMaxRadius || in.erosion_iterations < 0) {
    return CAGS_INVALID;
  }
  return guarded([&] { Alignment(in, *output).run(); });
}

int32_t cags_correct(const CagsCorrectInput* input, float* restored) {
  using namespace cags::align;
  const CagsCorrectInput& in = *input;
  if (!side(in.width) || !side(in.height) || !side(in.reference_width) || !side(in.reference_height) || in.threads < 1 ||
      in.radius_cells < 1 || in.radius_cells > kMaxRadius) {
    return CAGS_INVALID;
  }
  return guarded([&] { correct(in, restored); });
}
