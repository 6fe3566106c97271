// Stage 5: front-to-back compositing of one row of blocks of 4x4 pixels.
//
// A row's splats are taken in words of up to 64, in two passes: the alphas of all its blocks, and, block by block, the sums that
// hang together through the transmittance. One loop over both would chain some fifty cycles behind each other, more than a
// processor looks ahead. The first pass goes from splat to splat: what a splat is in the row is worked out once and serves the
// blocks that it reaches there, four in the mean. Its visits lie in one list, so that no loop of unforeseeable length breaks it,
// and two are done side by side, operation by operation.
#pragma once
#include "cags_kernels.h"
#include "raster/layout.h"
#include "raster/stages/cover.h"
#include "raster/stages/exponential.h"
#include "raster/stages/vector.h"

namespace cags::raster {
namespace {

constexpr int kVectors = kBlockPixels / kWidth;  // vectors a block
constexpr int kMaxVisits = kWordBits * kBlocksPerSide;
static_assert(kWidth % kBlock == 0, "the columns of a block's pixels are the same in each of its vectors");

// A splat of the batch relative to the tile: s = l11 x + l12 y + s0, t = l22 y + t0 at the tile's pixel (x, y).
struct Local {
  float l11, l12, s0, l22, t0, log2_opacity, r, g, b, z;
};

// A block's pixels. `depth` is the sum of weight x z.
struct alignas(64) BlockState {
  float transmittance[kBlockPixels], rgb[3][kBlockPixels], depth[kBlockPixels];
};

// A splat in one row of blocks: log2 of its alpha is height - (l11 x + shift)^2 at column x.
struct alignas(64) Slice {
  float shift[kBlockPixels], height[kBlockPixels];
  float l11;
};

// What a word's splats are in one row of blocks. Alphas lie block by block; `members` are each block's, a bit a splat.
struct alignas(64) Run {
  float pixel[kMaxVisits + 1][kBlockPixels];  // one more for the last of an odd number, which is done twice
  Slice slices[kWordBits];
  uint8_t slice[kMaxVisits + kBlocksPerSide], column[kMaxVisits + kBlocksPerSide];  // of each visit
  uint64_t members[kBlocksPerSide];
  int32_t place[kBlocksPerSide + 1];  // of each block's next alphas; the last is the odd one's
};

// What a word's splats have in common.
struct BlendInput {
  const Local* splats;
  float stop;
  float* sums;  // a splat's contribution
};

// The places of a byte's bits, the lowest first.
struct BitPlaces {
  uint8_t of[256][kBlocksPerSide];
};
constexpr BitPlaces bit_places() {
  BitPlaces out{};
  for (int byte = 0; byte < 256; byte++)
    for (int bit = 0, n = 0; bit < 8; bit++)
      if (byte >> bit & 1) out.of[byte][n++] = uint8_t(bit);
  return out;
}
inline constexpr BitPlaces kBitPlaces = bit_places();
static_assert(kBlocksPerSide == 8);

inline Floats columns_of(int block) {
  Floats x;
  for (int lane = 0; lane < kWidth; lane++) x[lane] = float(lane % kBlock);
  return x + float(block * kBlock);
}

inline void slice_of(const Local& splat, const Floats* y, Slice& out) {
  for (int j = 0; j < kVectors; j++) {
    const Floats t = y[j] * splat.l22 + splat.t0;
    store(out.height + j * kWidth, splat.log2_opacity - t * t);
    store(out.shift + j * kWidth, y[j] * splat.l12 + splat.s0);
  }
  out.l11 = splat.l11;
}

// Lists the visits of a word's splats to a row's blocks in `alive`, splat by splat. Returns how many.
inline int list_visits(const Local* splats, const uint8_t* reached, int row, uint8_t alive, Run& run) {
  Floats y[kVectors];
  for (int j = 0; j < kVectors; j++) {
    for (int lane = 0; lane < kWidth; lane++) y[j][lane] = float((j * kWidth + lane) / kBlock);
    y[j] += float(row * kBlock);
  }
  uint64_t some = 0;
  int count = 0, slices = 0;
  for (int column = 0; column < kBlocksPerSide; column++) {
    const uint64_t members = alive >> column & 1 ? gather_bit(reached, column) : 0;
    run.members[column] = members, run.place[column] = count;
    count += __builtin_popcountll(members), some |= members;
  }
  run.place[kBlocksPerSide] = count;
  for (int n = 0; some; some &= some - 1, slices++) {
    const int i = __builtin_ctzll(some);
    const uint8_t blocks = reached[i] & alive;
    slice_of(splats[i], y, run.slices[slices]);
    std::memcpy(run.column + n, kBitPlaces.of[blocks], kBlocksPerSide);
    std::memset(run.slice + n, slices, kBlocksPerSide);
    n += __builtin_popcount(blocks);
  }
  return count;
}

// First pass: the alphas of a word's splats in a row of blocks, zero under the cut. Returns how many visits there are.
template <int kDegree>
[[gnu::noinline]] int alphas(const Local* splats, const uint8_t* reached, int row, uint8_t alive, Run& run) {
  const int count = list_visits(splats, reached, row, alive, run);
  Floats x[kBlocksPerSide + 1];
  for (int column = 0; column <= kBlocksPerSide; column++) x[column] = columns_of(column);
  run.slice[count] = 0, run.column[count] = kBlocksPerSide;
  for (int n = 0; n < count; n += 2) {
    Floats power[2 * kVectors], alpha[2 * kVectors];
    float* to[2];
    for (int k = 0; k < 2; k++) {
      const Slice& slice = run.slices[run.slice[n + k]];
      const int column = run.column[n + k];
      to[k] = run.pixel[run.place[column]++];
      for (int j = 0; j < kVectors; j++) {
        const Floats s = x[column] * slice.l11 + load(slice.shift + j * kWidth);
        power[k * kVectors + j] = load(slice.height + j * kWidth) - s * s;
      }
    }
    exp2<kDegree>(power, alpha);
    for (int i = 0; i < 2 * kVectors; i++)
      store(to[i / kVectors] + i % kVectors * kWidth, keep(power[i] >= kLog2AlphaCut, lesser(alpha[i], all(kAlphaMax))));
  }
  return count;
}

// Second pass: front to back, sums colours and depth into the block, and each splat's weight into input.sums when
// kContribution. Returns whether the block is finished.
template <int kDepth, bool kContribution>
[[gnu::noinline]] bool accumulate(const BlendInput& input, uint64_t members, const float (*alpha)[kBlockPixels],
                                  BlockState& state) {
  Floats transmittance[kVectors], r[kVectors], g[kVectors], b[kVectors], depth[kVectors];
  for (int j = 0; j < kVectors; j++) {
    transmittance[j] = load(state.transmittance + j * kWidth);
    r[j] = load(state.rgb[0] + j * kWidth), g[j] = load(state.rgb[1] + j * kWidth), b[j] = load(state.rgb[2] + j * kWidth);
    if constexpr (kDepth != CAGS_DEPTH_NONE) depth[j] = load(state.depth + j * kWidth);
  }
  for (; members; members &= members - 1, alpha++) {
    const int i = __builtin_ctzll(members);
    const Local& splat = input.splats[i];
    Floats total{};
    for (int j = 0; j < kVectors; j++) {
      const Floats w = transmittance[j] * load(*alpha + j * kWidth);
      r[j] += w * splat.r, g[j] += w * splat.g, b[j] += w * splat.b;
      if constexpr (kDepth == CAGS_DEPTH_EXPECTED) depth[j] += w * splat.z;
      transmittance[j] -= w;
      if constexpr (kContribution) total += w;
    }
    if constexpr (kContribution) input.sums[i] += sum(total);
  }
  Floats most = transmittance[0];
  for (int j = 0; j < kVectors; j++) {
    most = greater(most, transmittance[j]);
    store(state.transmittance + j * kWidth, transmittance[j]);
    store(state.rgb[0] + j * kWidth, r[j]), store(state.rgb[1] + j * kWidth, g[j]), store(state.rgb[2] + j * kWidth, b[j]);
    if constexpr (kDepth != CAGS_DEPTH_NONE) store(state.depth + j * kWidth, depth[j]);
  }
  return !bits(most > input.stop);
}

using Accumulate = bool (*)(const BlendInput&, uint64_t members, const float (*alpha)[kBlockPixels], BlockState&);

// Blends a word's splats into a row of blocks, of which those in `alive` are not finished; `reached` says which a splat reaches.
// Returns the blocks that are now finished.
template <int kDegree, Accumulate accumulate>
uint8_t blend(const BlendInput& input, const uint8_t* reached, int row, uint8_t alive, BlockState* blocks, Run& run,
              int64_t& visits) {
  const int count = alphas<kDegree>(input.splats, reached, row, alive, run);
  visits += count;
  const float (*alpha)[kBlockPixels] = run.pixel;
  uint8_t done = 0;
  for (int column = 0; column < kBlocksPerSide; column++) {
    const uint64_t members = run.members[column];
    if (!members) continue;
    if (accumulate(input, members, alpha, blocks[column])) done |= uint8_t(1 << column);
    alpha += __builtin_popcountll(members);
  }
  return done;
}

}  // namespace
}  // namespace cags::raster
