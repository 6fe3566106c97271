#include "correct/cags_correct.h"
#include "correct/stages.h"
#include "support/aligned.h"
#include "support/calls.h"
#include "support/float_mode.h"
#include "support/instruction_set.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <vector>

namespace cags::correct {
namespace {

constexpr int kMaxSide = 16384;  // pixels
constexpr int kRowsAPiece = 16;
constexpr float kLeastWeight = 1e-6f;

const Stages& stages() { return in_use(CAGS_VARIANTS(stages)); }

struct Scratch {
  AlignedArray<Nearest> nearest;
  AlignedArray<float> limit, cells, lines, filled;
  AlignedArray<const float*> rows;
  AlignedArray<float> sums;
  AlignedArray<uint64_t> hidden;
  AlignedArray<uint8_t> marked;  // of rows of cells: those that a later pass looks at again
};

bool side(int value) { return value >= 1 && value <= kMaxSide; }

int64_t lack_values(int width, int height) { return int64_t{width + 1} * (height + 2) * kTap; }

bool valid(const CagsLackInput& in, int64_t length) {
  if (!side(in.width) || !side(in.height) || in.threads < 1 || !(in.knee >= 1e-3f && in.knee <= 10.0f)) return false;
  if (!(in.error >= 0 && in.error <= 1)) return false;
  const int64_t picture = int64_t{in.width} * in.height * 3;
  return in.coded && in.coded_length == picture && in.own_length == (in.own ? picture : 0) &&
         length == lack_values(in.width, in.height);
}

int64_t veto_values(const CagsAddInput& in) {
  if (!in.veto) return 0;
  const int64_t cell = in.coarse_veto ? kVetoCell : 1;
  return ((in.width + cell - 1) / cell) * ((in.height + cell - 1) / cell);
}

bool valid(const CagsAddInput& in, int64_t shown_length, int64_t confidence_length) {
  if (!side(in.width) || !side(in.height) || !side(in.reference_width) || !side(in.reference_height)) return false;
  if (in.threads < 1 || in.stride < 1) return false;
  const int64_t pixels = int64_t{in.width} * in.height;
  return in.rgb_length == 3 * pixels && in.alpha_length == pixels && in.depth_length == pixels &&
         in.lack_length == lack_values(in.reference_width, in.reference_height) && in.veto_length == veto_values(in) &&
         shown_length == 3 * pixels && confidence_length == pixels;
}

// What coding is taken to have left in a neighbourhood of a picture: more where the own view, over the whole, errs less.
float noise_of(const CagsLackInput& in, float* apart) {
  const int threads = std::min(in.threads, kMaxThreads);
  parallel_for(threads, in.height, [&](int row, int) { apart[row] = static_cast<float>(stages().apart(in, row)); });
  double sum = 0;
  for (int row = 0; row < in.height; row++) sum += apart[row];
  const float over_own = std::max(static_cast<float>(sum / (3.0 * in.width * in.height)) - in.error, 1e-9f);
  return kNoiseWeight * std::max(1.0f, in.error / over_own) * in.error;
}

void lack_of(const CagsLackInput& in, int16_t* lack) {
  const size_t pitch = size_t(in.width + 1) * kTap;
  const int threads = std::min(in.threads, kMaxThreads);
  Lease<Scratch> scratch;
  const size_t each = Near::floats(in.width);
  float* lines = in.own ? scratch->lines.reserve(each * threads + in.height) : nullptr;
  const float noise = in.own ? noise_of(in, lines + each * threads) : 0;
  parallel_for(threads, (in.height + kRowsAPiece - 1) / kRowsAPiece, [&](int piece, int worker) {
    FlushDenormals flush;
    const int begin = piece * kRowsAPiece, end = std::min(in.height, begin + kRowsAPiece);
    if (in.own) return stages().compare(in, noise, begin, end, Near(lines + each * worker, in.width), lack + (begin + 1) * pitch);
    for (int row = begin; row < end; row++) stages().expand(in, row, lack + (row + 1) * pitch);
  });
  std::copy_n(lack + pitch, pitch, lack);
  std::copy_n(lack + in.height * pitch, pitch, lack + (in.height + 1) * pitch);
}

// Half as many cells a side, of the four below each.
void pull(const Cells& fine, const Cells& coarse) {
  for (int y = 0; y < coarse.rows; y++) {
    for (int x = 0; x < coarse.columns; x++) {
      float value = 0, weight = 0;
      for (int j = 2 * y; j < std::min(2 * y + 2, fine.rows); j++) {
        for (int i = 2 * x; i < std::min(2 * x + 2, fine.columns); i++) {
          const size_t at = size_t(j) * fine.columns + i;
          value += fine.inverse[at] * fine.weight[at], weight += fine.weight[at];
        }
      }
      const size_t to = size_t(y) * coarse.columns + x;
      coarse.inverse[to] = value / std::max(weight, kLeastWeight), coarse.weight[to] = std::min(weight, 1.0f);
    }
  }
}

float between(const Cells& coarse, float x, float y) {
  const float fx = std::clamp(x - 0.5f, 0.0f, static_cast<float>(coarse.columns - 1)),
              fy = std::clamp(y - 0.5f, 0.0f, static_cast<float>(coarse.rows - 1));
  const int x0 = static_cast<int>(fx), y0 = static_cast<int>(fy), x1 = std::min(x0 + 1, coarse.columns - 1),
            y1 = std::min(y0 + 1, coarse.rows - 1);
  const float ax = fx - static_cast<float>(x0), ay = fy - static_cast<float>(y0);
  const float *top = coarse.inverse + size_t(y0) * coarse.columns, *low = coarse.inverse + size_t(y1) * coarse.columns;
  const float upper = top[x0] + (top[x1] - top[x0]) * ax, lower = low[x0] + (low[x1] - low[x0]) * ax;
  return upper + (lower - upper) * ay;
}

// What a cell does not know it takes from the coarser ones.
void push(const Cells& fine, const Cells& coarse) {
  for (int y = 0; y < fine.rows; y++) {
    for (int x = 0; x < fine.columns; x++) {
      const size_t at = size_t(y) * fine.columns + x;
      const float share = fine.weight[at];
      if (share >= 1.0f) continue;
      const float around = between(coarse, (static_cast<float>(x) + 0.5f) / 2, (static_cast<float>(y) + 0.5f) / 2);
      fine.inverse[at] = around + (fine.inverse[at] - around) * share;
    }
  }
}

// Pull and push (Gortler et al. 1996, "The Lumigraph") over all levels of the cells; `levels` is the finest and what follows.
void smooth(const std::vector<Cells>& levels) {
  for (size_t i = 1; i < levels.size(); i++) pull(levels[i - 1], levels[i]);
  for (size_t i = levels.size() - 1; i > 0; i--) push(levels[i - 1], levels[i]);
}

std::vector<Cells> levels_of(const CagsAddInput& in, AlignedArray<float>& memory) {
  std::vector<Cells> levels;
  size_t floats = 0;
  for (int rows = (in.height + kCell - 1) / kCell, columns = (in.width + kCell - 1) / kCell;;
       rows = (rows + 1) / 2, columns = (columns + 1) / 2) {
    levels.push_back({nullptr, nullptr, rows, columns});
    floats += 2 * size_t(rows) * columns;
    if (rows == 1 && columns == 1) break;
  }
  float* next = memory.reserve(floats);
  for (Cells& level : levels) {
    level.inverse = next, level.weight = next + size_t(level.rows) * level.columns;
    next = level.weight + size_t(level.rows) * level.columns;
  }
  return levels;
}

void add(const CagsAddInput& in, float* shown, float* confidence) {
  Lease<Scratch> scratch;
  const int threads = std::min(in.threads, kMaxThreads);
  const std::vector<Cells> levels = levels_of(in, scratch->cells);
  const Cells& cells = levels.front();
  const size_t pixels = size_t(in.reference_width + 1) * (in.reference_height + 1),
               each = pixels + 8;  // with one that nobody looks at
  const size_t line = Line::floats(in.width);
  float* lines = scratch->lines.reserve(line * threads);
  uint8_t* marked = scratch->marked.reserve(cells.rows);
  const int runs = static_cast<int>(rounded_up(in.width, kRun) / kRun);
  const Around around{scratch->sums.reserve(size_t(cells.rows) * cells.columns * kLanes),
                      scratch->hidden.reserve(size_t(in.height) * runs), cells.columns, runs};
  Nearest* nearest = scratch->nearest.reserve(each * threads);
  std::fill_n(nearest, each * threads, kNobody);
  const size_t pitch = Depths::pitch_of(in.width);
  const Depths depths{scratch->rows.reserve(in.height), scratch->filled.reserve(pitch * in.height), pitch};

  parallel_for(threads, cells.rows, [&](int row, int worker) {
    FlushDenormals flush;
    marked[row] = stages().survey(in, row, Line(lines + line * worker, in.width), cells, depths, nearest + each * worker);
  });
  if (std::any_of(marked, marked + cells.rows, [](uint8_t has) { return has != 0; })) {
    smooth(levels);
    parallel_for(threads, cells.rows, [&](int row, int worker) {
      FlushDenormals flush;
      if (marked[row]) stages().patch(in, row, Line(lines + line * worker, in.width), cells, depths, nearest + each * worker);
    });
  }
  float* limit = scratch->limit.reserve(pixels);
  const float tolerance = 1.0f + in.depth_tolerance;
  parallel_for(threads, (in.reference_height + kRowsAPiece) / kRowsAPiece, [&](int piece, int) {
    const size_t begin = size_t(piece) * kRowsAPiece * (in.reference_width + 1);
    const size_t end = std::min(pixels, begin + size_t(kRowsAPiece) * (in.reference_width + 1));
    for (size_t i = begin; i < end; i++) {
      for (int worker = 1; worker < threads; worker++) nearest[i] = std::min(nearest[i], nearest[i + each * worker]);
      limit[i] = std::bit_cast<float>(static_cast<uint32_t>(nearest[i] >> 32)) * tolerance;
    }
  });
  parallel_for(threads, cells.rows, [&](int row, int worker) {
    FlushDenormals flush;
    marked[row] =
        stages().finish(in, row, Line(lines + line * worker, in.width), depths, {nearest, limit}, around, shown, confidence);
  });
  if (std::none_of(marked, marked + cells.rows, [](uint8_t has) { return has != 0; })) return;
  parallel_for(threads, cells.rows, [&](int row, int) {
    FlushDenormals flush;
    if (marked[row]) stages().surround(in, row, around, shown, confidence);
  });
}

}  // namespace
}  // namespace cags::correct

int32_t cags_lack(const CagsLackInput* input, int16_t* lack, int64_t length) {
  if (!lack || !cags::correct::valid(*input, length)) return CAGS_INVALID;
  return cags::guarded([&] { cags::correct::lack_of(*input, lack); });
}

int32_t cags_add_lack(const CagsAddInput* input, float* shown, int64_t shown_length, float* confidence,
                      int64_t confidence_length) {
  if (!shown || !confidence || !cags::correct::valid(*input, shown_length, confidence_length)) return CAGS_INVALID;
  return cags::guarded([&] { cags::correct::add(*input, shown, confidence); });
}
