// Stage 5: front-to-back compositing of one block of 4x4 pixels, and its adjoint.
//
// A block's splats are taken in runs of up to 64, in two passes: the alphas, and the sums that hang together through the
// transmittance. One loop over both would chain some fifty cycles behind each other, more than a processor looks ahead. The
// alphas are done for two splats at a time, operation by operation, so that independent work lies side by side.
#pragma once
#include "cags_kernels.h"
#include "raster/layout.h"
#include "raster/stages/cover.h"
#include "raster/stages/exponential.h"
#include "raster/stages/vector.h"

namespace cags::raster {
namespace {

constexpr int kVectors = kBlockPixels / kWidth;  // vectors a block

// A splat of the batch relative to the tile: s = l11 x + l12 y + s0, t = l22 y + t0 at the tile's pixel (x, y).
struct Local {
  float l11, l12, s0, l22, t0, log2_opacity, r, g, b, z;
};

// A block's pixels. `depth` is the sum of weight x z, or the median's z (0 while transmittance is above one half).
// In the adjoint `rgb` holds the residual.
struct alignas(64) BlockState {
  float transmittance[kBlockPixels], rgb[3][kBlockPixels], depth[kBlockPixels];
};

// The members of one word of a block's bit set: their positions in the batch, and their alphas by pixel.
struct alignas(64) Run {
  float pixel[kWordBits][kBlockPixels];  // an even number of rows, see alphas
  uint8_t splat[kWordBits];
  int count;
};

// What a batch's blocks have in common.
struct BlendInput {
  const Local* splats;
  int words;      // of each block's bit set
  float stop;
  float* sums;    // a splat's contribution, or its (weight x residual, weight)
};

// The columns and rows of a block's pixels.
struct Grid {
  Floats x[kVectors], y[kVectors];
};

inline Grid grid_of(int block) {
  Grid out;
  for (int j = 0; j < kVectors; j++) {
    for (int lane = 0; lane < kWidth; lane++) {
      const int pixel = j * kWidth + lane;
      out.x[j][lane] = float(pixel % kBlock), out.y[j][lane] = float(pixel / kBlock);
    }
    out.x[j] += float(block % kBlocksPerSide * kBlock), out.y[j] += float(block / kBlocksPerSide * kBlock);
  }
  return out;
}

// log2 of a splat's alphas at a block's pixels.
inline void powers(const Local& splat, const Grid& grid, Floats* out) {
  for (int j = 0; j < kVectors; j++) {
    const Floats t = grid.y[j] * splat.l22 + splat.t0;
    const Floats s = grid.y[j] * splat.l12 + (grid.x[j] * splat.l11 + splat.s0);
    out[j] = splat.log2_opacity - t * t - s * s;
  }
}

// First pass: the alphas of a word's members, zero under the cut. The word's first bit is the batch's splat `first`. The last
// of an odd number is done twice; the run's rows have room for that.
template <int kDegree>
[[gnu::noinline]] void alphas(const Local* splats, uint64_t members, int first, int block, Run& run) {
  const Grid grid = grid_of(block);
  run.count = __builtin_popcountll(members);
  for (int n = 0; members; n += 2) {
    const int one = first + __builtin_ctzll(members);
    members &= members - 1;
    const int two = members ? first + __builtin_ctzll(members) : one;
    members &= members - 1;
    run.splat[n] = uint8_t(one), run.splat[n + 1] = uint8_t(two);
    Floats power[2 * kVectors], alpha[2 * kVectors];
    powers(splats[one], grid, power);
    powers(splats[two], grid, power + kVectors);
    exp2<kDegree>(power, alpha);
    for (int j = 0; j < 2 * kVectors; j++)
      store(run.pixel[n] + j * kWidth, keep(power[j] >= kLog2AlphaCut, lesser(alpha[j], all(kAlphaMax))));
  }
}

// Second pass: front to back, sums colours and depth into the block, and each splat's weight into input.sums when
// kContribution. Returns whether the block is finished.
template <int kDepth, bool kContribution>
[[gnu::noinline]] bool accumulate(const BlendInput& input, const Run& run, BlockState& state) {
  Floats transmittance[kVectors], r[kVectors], g[kVectors], b[kVectors], depth[kVectors];
  for (int j = 0; j < kVectors; j++) {
    transmittance[j] = load(state.transmittance + j * kWidth);
    r[j] = load(state.rgb[0] + j * kWidth), g[j] = load(state.rgb[1] + j * kWidth), b[j] = load(state.rgb[2] + j * kWidth);
    if constexpr (kDepth != CAGS_DEPTH_NONE) depth[j] = load(state.depth + j * kWidth);
  }
  for (int i = 0; i < run.count; i++) {
    const Local& splat = input.splats[run.splat[i]];
    Floats total{};
    for (int j = 0; j < kVectors; j++) {
      const Floats w = transmittance[j] * load(run.pixel[i] + j * kWidth), after = transmittance[j] - w;
      r[j] += w * splat.r, g[j] += w * splat.g, b[j] += w * splat.b;
      if constexpr (kDepth == CAGS_DEPTH_EXPECTED) depth[j] += w * splat.z;
      if constexpr (kDepth == CAGS_DEPTH_MEDIAN)
        depth[j] = select((transmittance[j] >= 0.5f) & (after < 0.5f), all(splat.z), depth[j]);
      transmittance[j] = after;
      if constexpr (kContribution) total += w;
    }
    if constexpr (kContribution) input.sums[run.splat[i]] += sum(total);
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

// The adjoint's second pass: adds (weight x residual, weight) of each splat to input.sums.
[[gnu::noinline]] inline bool accumulate_back(const BlendInput& input, const Run& run, BlockState& state) {
  Floats transmittance[kVectors];
  for (int j = 0; j < kVectors; j++) transmittance[j] = load(state.transmittance + j * kWidth);
  Floats residual[3][kVectors];
  for (int c = 0; c < 3; c++)
    for (int j = 0; j < kVectors; j++) residual[c][j] = load(state.rgb[c] + j * kWidth);
  for (int i = 0; i < run.count; i++) {
    Floats total[4] = {};
    for (int j = 0; j < kVectors; j++) {
      const Floats w = transmittance[j] * load(run.pixel[i] + j * kWidth);
      transmittance[j] -= w;
      for (int c = 0; c < 3; c++) total[c] += w * residual[c][j];
      total[3] += w;
    }
    add_sums(total, input.sums + 4 * run.splat[i]);
  }
  Floats most = transmittance[0];
  for (int j = 0; j < kVectors; j++) {
    most = greater(most, transmittance[j]);
    store(state.transmittance + j * kWidth, transmittance[j]);
  }
  return !bits(most > input.stop);
}

// Blends the members of one block; returns true when the block is finished.
template <int kDepth, bool kContribution, int kDegree>
bool blend(const BlendInput& input, const uint64_t* members, int block, BlockState& state, Run& run, int64_t& visits) {
  bool done = false;
  for (int word = 0; word < input.words && !done; word++) {
    if (!members[word]) continue;
    alphas<kDegree>(input.splats, members[word], word * kWordBits, block, run);
    done = accumulate<kDepth, kContribution>(input, run, state);
    visits += run.count;
  }
  return done;
}

template <int kDegree>
bool blend_back(const BlendInput& input, const uint64_t* members, int block, BlockState& state, Run& run, int64_t& visits) {
  bool done = false;
  for (int word = 0; word < input.words && !done; word++) {
    if (!members[word]) continue;
    alphas<kDegree>(input.splats, members[word], word * kWordBits, block, run);
    done = accumulate_back(input, run, state);
    visits += run.count;
  }
  return done;
}

}  // namespace
}  // namespace cags::raster
