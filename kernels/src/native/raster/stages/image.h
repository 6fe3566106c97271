// Between a tile's blocks and the image's rows.
#pragma once
#include "raster/layout.h"
#include "raster/stages/blend.h"

#include <limits>

namespace cags::raster {
namespace {

constexpr float kVoidDepth = std::numeric_limits<float>::infinity();

struct TileArea {
  int x, y, width, height;  // pixels; width and height are cut at the image's edge
};

inline TileArea area_of(const View& view, int tile) {
  TileArea a{tile % view.tiles_x * kTile, tile / view.tiles_x * kTile, kTile, kTile};
  if (a.x + kTile > view.width) a.width = view.width - a.x;
  if (a.y + kTile > view.height) a.height = view.height - a.y;
  return a;
}

inline Quad load_quad(const float* p) { return load<Quad>(p); }

// Depth of four pixels: expected or median, infinite where void.
inline Quad finished_depth(const View& view, Quad depth, Quad alpha) {
  typedef int32_t QuadMask __attribute__((vector_size(16)));
  const QuadMask known = (alpha >= view.void_alpha) & (alpha > 0.0f) & (depth > 0.0f);
  const Quad value = view.depth == CAGS_DEPTH_MEDIAN ? depth : depth / alpha;
  return Quad((known & QuadMask(value)) | (~known & QuadMask(Quad{} + kVoidDepth)));
}

// Four pixels as r g b r g b r g b r g b.
inline void store_interleaved(Quad r, Quad g, Quad b, float* out) {
#if defined(__x86_64__)
  const __m128 rg = _mm_unpacklo_ps(__m128(r), __m128(g)), rg2 = _mm_unpackhi_ps(__m128(r), __m128(g));  // r0 g0 r1 g1, ...
  const __m128 br = _mm_shuffle_ps(__m128(b), __m128(r), _MM_SHUFFLE(1, 1, 0, 0));                          // b0 b0 r1 r1
  const __m128 gb = _mm_shuffle_ps(__m128(g), __m128(b), _MM_SHUFFLE(1, 1, 1, 1));                          // g1 g1 b1 b1
  const __m128 br2 = _mm_shuffle_ps(__m128(b), __m128(r), _MM_SHUFFLE(3, 3, 2, 2));                         // b2 b2 r3 r3
  const __m128 gb2 = _mm_shuffle_ps(__m128(g), __m128(b), _MM_SHUFFLE(3, 3, 3, 3));                         // g3 g3 b3 b3
  _mm_storeu_ps(out, _mm_shuffle_ps(rg, br, _MM_SHUFFLE(2, 0, 1, 0)));
  _mm_storeu_ps(out + 4, _mm_shuffle_ps(gb, rg2, _MM_SHUFFLE(1, 0, 2, 0)));
  _mm_storeu_ps(out + 8, _mm_shuffle_ps(br2, gb2, _MM_SHUFFLE(2, 0, 2, 0)));
#else
  for (int i = 0; i < 4; i++) out[3 * i] = r[i], out[3 * i + 1] = g[i], out[3 * i + 2] = b[i];
#endif
}
static_assert(kBlock == 4);

// Four pixels of a block's row, as the image holds them.
struct PixelRun {
  float rgb[3 * kBlock], alpha[kBlock], depth[kBlock];
};

inline void write_run(const View& view, const BlockState& state, int row, float* rgb, float* alpha, float* depth) {
  const int at = row * kBlock;
  if (rgb) store_interleaved(load_quad(state.rgb[0] + at), load_quad(state.rgb[1] + at), load_quad(state.rgb[2] + at), rgb);
  const Quad opaque = 1.0f - load_quad(state.transmittance + at);
  if (alpha) store(alpha, opaque);
  if (depth) store(depth, finished_depth(view, load_quad(state.depth + at), opaque));
}

inline void write_tile(const View& view, const TileArea& area, const BlockState* blocks, const Targets& targets) {
  for (int y = 0; y < area.height; y++)
    for (int x = 0; x < area.width; x += kBlock) {
      const BlockState& state = blocks[y / kBlock * kBlocksPerSide + x / kBlock];
      const size_t at = size_t(area.y + y) * view.width + area.x + x;
      float *rgb = targets.rgb ? targets.rgb + 3 * at : nullptr, *alpha = targets.alpha ? targets.alpha + at : nullptr;
      float* depth = targets.depth ? targets.depth + at : nullptr;
      const int n = area.width - x;
      if (n >= kBlock) {
        write_run(view, state, y % kBlock, rgb, alpha, depth);
        continue;
      }
      PixelRun run;
      write_run(view, state, y % kBlock, run.rgb, run.alpha, run.depth);
      if (rgb) std::memcpy(rgb, run.rgb, 3 * n * sizeof(float));
      if (alpha) std::memcpy(alpha, run.alpha, n * sizeof(float));
      if (depth) std::memcpy(depth, run.depth, n * sizeof(float));
    }
}

// A tile that no splat reaches.
inline void write_void(const View& view, const TileArea& area, const Targets& targets) {
  for (int y = 0; y < area.height; y++) {
    const size_t at = size_t(area.y + y) * view.width + area.x;
    if (targets.rgb) std::memset(targets.rgb + 3 * at, 0, 3 * area.width * sizeof(float));
    if (targets.alpha) std::memset(targets.alpha + at, 0, area.width * sizeof(float));
    for (int x = 0; targets.depth && x < area.width; x++) targets.depth[at + x] = kVoidDepth;
  }
}

inline void load_residual(const View& view, const TileArea& area, const float* residual, BlockState* blocks) {
  for (int y = 0; y < area.height; y++)
    for (int x = 0; x < area.width; x++) {
      const float* from = residual + 3 * (size_t(area.y + y) * view.width + area.x + x);
      BlockState& state = blocks[y / kBlock * kBlocksPerSide + x / kBlock];
      for (int c = 0; c < 3; c++) state.rgb[c][y % kBlock * kBlock + x % kBlock] = from[c];
    }
}

}  // namespace
}  // namespace cags::raster
