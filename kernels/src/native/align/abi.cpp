#include "align/cags_align.h"
#include "align/calls.h"
#include "align/erode.h"
#include "align/stages.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <bit>
#include <vector>

namespace cags::align {
namespace {

constexpr int kMaxSide = 16384;  // pixels
constexpr int kMaxRadius = 64;
constexpr double kLeastPower = 1e-12;                // of a correction, where there is none
constexpr double kEvidenceMargin = 1.05;             // see cags_client.restore.affine
constexpr double kVeilWeight = 2.2;
constexpr int kRowsAFit = 32;  // the rows around them, of which the sums are made twice, are few beside them

bool side(int value) { return value >= 1 && value <= kMaxSide; }

bool valid(const CagsReprojection& view) {
  return side(view.width) && side(view.height) && side(view.reference_width) && side(view.reference_height);
}

bool valid(const CagsAlignInput& in) {
  return valid(in.view) && in.threads >= 1 && in.stride >= 1 && in.erosion_radius >= 0 && in.erosion_radius <= kMaxErosion &&
         in.erosion_iterations >= 0;
}

Padded padded_colours(const CagsAlignInput& in, AlignedArray<float>& memory) {
  const int w = in.view.reference_width, h = in.view.reference_height;
  Padded out{memory.reserve(size_t(w + 2) * (h + 2) * kColourLanes), w, h};
  for_rows(in.threads, h + 2, [&](int row, int) {
    const float* from = in.reference + int64_t{std::clamp(row - 1, 0, h - 1)} * w * 3;
    float* to = out.data + int64_t{row} * (w + 2) * kColourLanes;
    for (int column = -1; column <= w; column++, to += kColourLanes) {
      const float* pixel = from + 3 * std::clamp(column, 0, w - 1);
      to[0] = pixel[0], to[1] = pixel[1], to[2] = pixel[2], to[3] = 0.0f;
    }
  });
  return out;
}

size_t cells_of(const CagsReprojection& view) { return size_t(view.reference_width + 1) * (view.reference_height + 1); }

// The nearest of the client's pixels in each cell.
Occlusion looked_over(const CagsAlignInput& in, Scratch& scratch, int threads) {
  const int rows = (in.view.height + in.stride - 1) / in.stride, across = in.view.reference_width + 1;
  const size_t cells = cells_of(in.view);
  Nearest* nearest = scratch.nearest.reserve(cells * threads);
  float* depth = scratch.nearest_depth.reserve(cells);
  std::fill_n(nearest, cells * threads, kNobody);
  for_rows(threads, rows, [&](int row, int worker) { stages().nearest(in, row * in.stride, nearest + cells * worker); });
  for_rows(threads, in.view.reference_height + 1, [&](int row, int) {
    for (size_t i = size_t(row) * across; i < size_t(row + 1) * across; i++) {
      for (int worker = 1; worker < threads; worker++) nearest[i] = std::min(nearest[i], nearest[i + cells * worker]);
      depth[i] = std::bit_cast<float>(static_cast<uint32_t>(nearest[i] >> 32));
    }
  });
  return {nearest, depth, nullptr};
}

void fill(const CagsAlignInput& in, const CagsAlignOutput& out, const uint8_t* shared, Scratch& scratch) {
  const Erosion how{in.view.width, in.view.height, in.erosion_radius, in.erosion_iterations, in.threads};
  const CleanWord clean = [&](int row, int word) {
    const int first = word * kWord, count = std::min(kWord, in.view.width - first);
    return stages().clean(in, out.occluded + int64_t{row} * in.view.width + first, shared, row, first, count);
  };
  erode(how, out.occluded, clean, scratch.bits, out.rgb);
}

void align(const CagsAlignInput& in, const CagsAlignOutput& out) {
  ScratchLease scratch;
  const bool fills = out.rgb && in.erosion_radius > 0 && in.erosion_iterations > 0;
  Occlusion occlusion = looked_over(in, *scratch, in.threads);
  const Padded reference = out.rgb ? padded_colours(in, scratch->reference) : Padded{};
  if (fills) {
    occlusion.shared = scratch->shared.reserve(cells_of(in.view));
    std::fill_n(occlusion.shared, cells_of(in.view), uint8_t{0});
  }
  for_rows(in.threads, in.view.height, [&](int row, int) { stages().resolve(in, reference, occlusion, row, out); });
  if (fills) fill(in, out, occlusion.shared, *scratch);
}

Evidence sum_of(const std::vector<Evidence>& rows) {  // in one thread, so that the sums do not depend on their number
  Evidence all{};
  for (const Evidence& row : rows) {
    for (int c = 0; c < 3; c++) all.fine[c] += row.fine[c], all.broad[c] += row.broad[c], all.noise[c] += row.noise[c];
    all.shown += row.shown;
  }
  return all;
}

float trust_of(double power, double noise) {
  return static_cast<float>(std::clamp(2.0 * (power / std::max(noise, 1e-12) / kEvidenceMargin - 1.0), 0.0, 1.0));
}

// Means over the blocks that are seen.
Agreement mean_of(const std::vector<Agreement>& rows) {  // in one thread, so that the sums do not depend on their number
  Agreement all{};
  for (const Agreement& row : rows) {
    for (int c = 0; c < 3; c++) all.away[c] += row.away[c];
    all.power += row.power, all.seen += row.seen;
  }
  const double one = 1.0 / static_cast<double>(std::max<int64_t>(all.seen, 1));
  for (double& away : all.away) away *= one;
  all.power = std::max(all.power * one, kLeastPower);
  return all;
}

// What veils one of the client's two views alone veils all of it: its difference stays when all of them are averaged.
float own_share(const Agreement& all, float looked_for) {
  const double veil = all.away[0] * all.away[0] + all.away[1] * all.away[1] + all.away[2] * all.away[2];
  const double ratio = kVeilWeight * veil / all.power, square = ratio * ratio;
  return 1.0f - looked_for * (1.0f - static_cast<float>(1.0 / (1.0 + square * square)));
}

// Weighs the correction by how well the client's own two views agree through the alignment. No blocks: all of it counts.
Blocks registration(const CagsCorrectInput& in, const Padded& fields, const Padded& own, Scratch& scratch, int threads) {
  const int size = in.block_px;
  Blocks blocks{size, in.view.width / size, in.view.height / size, nullptr, nullptr};
  const size_t count = size_t(blocks.width) * blocks.height;
  if (count == 0 || in.misregistration == 0) return Blocks{};
  blocks.disagreement = scratch.disagreement.reserve(3 * count);
  blocks.weight = scratch.weight.reserve(count);
  std::vector<Agreement> rows(blocks.height);
  for_rows(threads, blocks.height, [&](int row, int) { stages().compare(in, fields, own, row, blocks, rows[row]); });
  const Agreement all = mean_of(rows);
  const float power = static_cast<float>(all.power);
  const float share = own_share(all, in.veil);
  const size_t line = 2 * size_t(blocks.width) + 2 * kAround;
  float* lines = scratch.lines.reserve(line * threads);
  for_rows(threads, blocks.height, [&](int row, int worker) {
    stages().settle(in, row, power, share, blocks, lines + line * worker);
  });
  return blocks;
}

// What the correction samples in the reference's view.
struct Fitted {
  Padded fields, own;
};

void fit(const CagsCorrectInput& in, Scratch& scratch, int threads, const Fitted& out) {
  const int w = in.view.reference_width, h = in.view.reference_height, window = 2 * in.radius_cells + 1;
  const size_t ring = size_t(window) * kMoments * kRun, line = size_t(kRun + window - 1) * kMoments;
  float* sums = scratch.sums.reserve((ring + line) * threads);
  float* parts = scratch.parts.reserve(size_t(w) * h * kParts);
  std::vector<Evidence> rows((h + kEvidenceRows - 1) / kEvidenceRows);
  parallel_for(threads, (h + kRowsAFit - 1) / kRowsAFit, [&](int piece, int worker) {
    float* own = sums + (ring + line) * worker;
    const int begin = piece * kRowsAFit;
    stages().fit(in, begin, std::min(h, begin + kRowsAFit), {own, own + ring}, parts, rows.data());
  });
  const Evidence evidence = sum_of(rows);
  float share[6];
  for (int c = 0; c < 3; c++) {
    share[c] = trust_of(evidence.fine[c], evidence.noise[c]);
    share[3 + c] = trust_of(evidence.broad[c], static_cast<double>(evidence.shown) * (kNoiseFloor + in.broad_noise[c]));
  }
  for_rows(threads, h, [&](int row, int) { stages().trust(in, row, parts, share, out.fields, out.own); });
}

Fitted fitted(const CagsCorrectInput& in, Scratch& scratch, int threads) {
  const int w = in.view.reference_width, h = in.view.reference_height;
  const size_t stride = size_t(w + 2) * kFieldLanes;
  const Fitted out{{scratch.fields.reserve(stride * (h + 2)), w, h}, {scratch.reference.reserve(stride * (h + 2)), w, h}};
  if (in.fields) {
    for_rows(threads, h, [&](int row, int) { stages().take(in, row, out.fields, out.own); });
  } else {
    fit(in, scratch, threads, out);
  }
  for (const Padded& picture : {out.fields, out.own}) {
    std::copy_n(picture.data + stride, stride, picture.data);
    std::copy_n(picture.data + stride * h, stride, picture.data + stride * (h + 1));
  }
  return out;
}

void correct(const CagsCorrectInput& in, float* restored) {
  ScratchLease scratch;
  const int threads = std::min(in.threads, kMaxThreads);
  const auto [fields, own] = fitted(in, *scratch, threads);
  const Blocks blocks = registration(in, fields, own, *scratch, threads);
  const size_t line = size_t(blocks.width) + kLineSlack;
  float* weights = scratch->lines.reserve(line * threads);
  for_rows(threads, in.view.height, [&](int row, int worker) {
    stages().correct(in, fields, blocks, row, weights + line * worker, restored);
  });
}

// The fields alone, without their border.
void fields_of(const CagsCorrectInput& in, float* out) {
  ScratchLease scratch;
  const int w = in.view.reference_width, threads = std::min(in.threads, kMaxThreads);
  const Padded fields = fitted(in, *scratch, threads).fields;
  for_rows(threads, in.view.reference_height, [&](int row, int) {
    const float* from = fields.data + ((int64_t{row} + 1) * (w + 2) + 1) * kFieldLanes;
    std::copy_n(from, w * kFieldLanes, out + int64_t{row} * w * kFieldLanes);
  });
}

}  // namespace
}  // namespace cags::align

int32_t cags_align(const CagsAlignInput* input, const CagsAlignOutput* output) {
  using namespace cags::align;
  if (!valid(*input)) return CAGS_INVALID;
  CagsAlignInput in = *input;
  in.threads = std::min(in.threads, cags::kMaxThreads);
  return cags::guarded([&] { cags::align::align(in, *output); });
}

static bool valid(const CagsCorrectInput& in) {
  return cags::align::valid(in.view) && in.threads >= 1 && in.radius_cells >= 1 && in.radius_cells <= cags::align::kMaxRadius &&
         in.block_px >= 1 && in.misregistration >= 0 && in.veil >= 0 && in.veil <= 1;
}

int32_t cags_fields(const CagsCorrectInput* input, float* fields) {
  if (!valid(*input)) return CAGS_INVALID;
  return cags::guarded([&] { cags::align::fields_of(*input, fields); });
}

int32_t cags_lay(const CagsLayInput* input, float* shown) {
  using namespace cags::align;
  if (!side(input->width) || !side(input->height) || input->threads < 1) return CAGS_INVALID;
  return cags::guarded([&] {
    for_rows(std::min(input->threads, cags::kMaxThreads), input->height,
             [&](int row, int) { stages().lay(*input, row, shown + row * input->shown_pitch); });
  });
}

int32_t cags_correct(const CagsCorrectInput* input, float* restored) {
  if (!valid(*input)) return CAGS_INVALID;
  return cags::guarded([&] { cags::align::correct(*input, restored); });
}
