// Stage 5: front-to-back compositing of one block of 4x4 pixels, and its adjoint.
//
// A block's splats are taken in runs of up to 64, in three passes: the logarithms of their alphas, the alphas, and the sums
// that hang together through the transmittance. One loop over all would chain some twenty operations behind each other, more
// than a processor looks ahead; each of the three is bound by its throughput, and keeps all it needs in registers.
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

// The members of one word of a block's bit set: their positions in the batch, and their log2 alpha, then alpha, by pixel.
struct alignas(64) Run {
  float pixel[kWordBits][kBlockPixels];
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

// First pass: takes the members of a word whose first bit is the batch's splat `first`, and the log2 of their alphas.
[[gnu::noinline]] inline void powers(const Local* splats, uint64_t members, int first, int block, Run& run) {
  const Grid grid = grid_of(block);
  int n = 0;
  for (; members; members &= members - 1, n++) {
    const int index = first + __builtin_ctzll(members);
    const Local& splat = splats[index];
    run.splat[n] = uint8_t(index);
    for (int j = 0; j < kVectors; j++) {
      const Floats t = grid.y[j] * splat.l22 + splat.t0;
      const Floats s = grid.y[j] * splat.l12 + (grid.x[j] * splat.l11 + splat.s0);
      store(run.pixel[n] + j * kWidth, splat.log2_opacity - t * t - s * s);
    }
  }
  run.count = n;
}

// Second pass: alphas of their logarithms; zero under the cut.
template <int kDegree>
[[gnu::noinline]] void alphas(Run& run) {
  float* pixel = run.pixel[0];
  for (int i = 0; i < run.count * kBlockPixels; i += kWidth) {
    const Floats power = load(pixel + i);
    store(pixel + i, keep(power >= kLog2AlphaCut, lesser(exp2<kDegree>(power), all(kAlphaMax))));
  }
}

// Third pass: front to back, sums colours and depth into the block, and each splat's weight into input.sums when
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
    powers(input.splats, members[word], word * kWordBits, block, run);
    alphas<kDegree>(run);
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
    powers(input.splats, members[word], word * kWordBits, block, run);
    alphas<kDegree>(run);
    done = accumulate_back(input, run, state);
    visits += run.count;
  }
  return done;
}

}  // namespace
}  // namespace cags::raster
