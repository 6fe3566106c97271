// Stage 5: front-to-back compositing of one block of 4x4 pixels, and its adjoint.
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
struct alignas(64) BlockState {
  float transmittance[kBlockPixels], rgb[3][kBlockPixels], depth[kBlockPixels];
};

struct PixelGrid {
  Floats x[kVectors], y[kVectors];
};

inline PixelGrid pixels_of_block(int block) {
  PixelGrid grid;
  for (int j = 0; j < kVectors; j++)
    for (int lane = 0; lane < kWidth; lane++) {
      const int pixel = j * kWidth + lane;
      grid.x[j][lane] = float(block % kBlocksPerSide * kBlock + pixel % kBlock);
      grid.y[j][lane] = float(block / kBlocksPerSide * kBlock + pixel / kBlock);
    }
  return grid;
}

// The splat's compositing weight at kWidth pixels that transmit `transmittance`; zero under the cut.
template <int kDegree>
inline Floats weight_of(const Local& g, Floats x, Floats y, Floats transmittance) {
  const Floats t = y * g.l22 + g.t0, s = x * g.l11 + (y * g.l12 + g.s0);
  const Floats power = g.log2_opacity - t * t - s * s;
  const Floats alpha = lesser(exp2<kDegree>(power), all(kAlphaMax));
  return keep(power >= kLog2AlphaCut, transmittance * alpha);
}

inline float sum(Floats v) {
  float total = 0.0f;
  for (int i = 0; i < kWidth; i++) total += v[i];
  return total;
}

inline bool finished(const Floats* transmittance, float stop) {
  Floats most = transmittance[0];
  for (int j = 1; j < kVectors; j++) most = greater(most, transmittance[j]);
  return !bits(most > stop);
}

// Blends the members of one block; returns true when the block is finished. Adds each splat's weight to sums[splat] when
// kContribution.
template <int kDepth, bool kContribution, int kDegree>
bool blend(BlockState& state, const Local* splats, const uint64_t* members, int words, int block, float stop, float* sums,
           int64_t& visits) {
  const PixelGrid grid = pixels_of_block(block);
  Floats transmittance[kVectors], r[kVectors], g[kVectors], b[kVectors], depth[kVectors];
  for (int j = 0; j < kVectors; j++) {
    transmittance[j] = load(state.transmittance + j * kWidth), depth[j] = load(state.depth + j * kWidth);
    r[j] = load(state.rgb[0] + j * kWidth), g[j] = load(state.rgb[1] + j * kWidth), b[j] = load(state.rgb[2] + j * kWidth);
  }
  bool done = false;
  for (int word = 0; word < words && !done; word++) {
    uint64_t left = members[word];
    if (!left) continue;
    visits += __builtin_popcountll(left);
    for (; left; left &= left - 1) {
      const int index = word * kWordBits + __builtin_ctzll(left);
      const Local& splat = splats[index];
      Floats total{};
      for (int j = 0; j < kVectors; j++) {
        const Floats w = weight_of<kDegree>(splat, grid.x[j], grid.y[j], transmittance[j]);
        if constexpr (kDepth == CAGS_DEPTH_MEDIAN) {
          const Floats after = transmittance[j] - w;
          depth[j] = select((transmittance[j] >= 0.5f) & (after < 0.5f), all(splat.z), depth[j]);
        }
        if constexpr (kDepth == CAGS_DEPTH_EXPECTED) depth[j] += w * splat.z;
        transmittance[j] -= w;
        r[j] += w * splat.r, g[j] += w * splat.g, b[j] += w * splat.b;
        if constexpr (kContribution) total += w;
      }
      if constexpr (kContribution) sums[index] += sum(total);
    }
    done = finished(transmittance, stop);
  }
  for (int j = 0; j < kVectors; j++) {
    store(state.transmittance + j * kWidth, transmittance[j]), store(state.depth + j * kWidth, depth[j]);
    store(state.rgb[0] + j * kWidth, r[j]), store(state.rgb[1] + j * kWidth, g[j]), store(state.rgb[2] + j * kWidth, b[j]);
  }
  return done;
}

// The adjoint: state.rgb holds the residual; adds (weight x residual, weight) of each splat to sums[splat].
template <int kDegree>
bool blend_back(BlockState& state, const Local* splats, const uint64_t* members, int words, int block, float stop, float* sums,
                int64_t& visits) {
  const PixelGrid grid = pixels_of_block(block);
  Floats transmittance[kVectors], residual[3][kVectors];
  for (int j = 0; j < kVectors; j++) {
    transmittance[j] = load(state.transmittance + j * kWidth);
    for (int c = 0; c < 3; c++) residual[c][j] = load(state.rgb[c] + j * kWidth);
  }
  bool done = false;
  for (int word = 0; word < words && !done; word++) {
    uint64_t left = members[word];
    if (!left) continue;
    visits += __builtin_popcountll(left);
    for (; left; left &= left - 1) {
      const int index = word * kWordBits + __builtin_ctzll(left);
      Floats total[4] = {};
      for (int j = 0; j < kVectors; j++) {
        const Floats w = weight_of<kDegree>(splats[index], grid.x[j], grid.y[j], transmittance[j]);
        transmittance[j] -= w;
        for (int c = 0; c < 3; c++) total[c] += w * residual[c][j];
        total[3] += w;
      }
      for (int c = 0; c < 4; c++) sums[4 * index + c] += sum(total[c]);
    }
    done = finished(transmittance, stop);
  }
  for (int j = 0; j < kVectors; j++) store(state.transmittance + j * kWidth, transmittance[j]);
  return done;
}

}  // namespace
}  // namespace cags::raster
