// Between a tile's blocks and the image's rows.
#pragma once
#include "raster/layout.h"
#include "raster/stages/blend.h"

#include <limits>

namespace cags::raster {
namespace {

constexpr int kLineBytes = 64;                     // of the caches
constexpr int64_t kLeastStreamedPixels = 400'000;  // 8 MB with alpha and depth
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

// Depth of four pixels, infinite where void.
inline Quad finished_depth(const View& view, Quad depth, Quad alpha) {
  typedef int32_t QuadMask __attribute__((vector_size(16)));
  const QuadMask known = (alpha >= view.void_alpha) & (alpha > 0.0f) & (depth > 0.0f);
  const Quad value = depth / alpha;
  return Quad((known & QuadMask(value)) | (~known & QuadMask(Quad{} + kVoidDepth)));
}

struct Interleaved {
  Quad part[3];  // r g b r, g b r g, b r g b
};

inline Interleaved interleaved(Quad r, Quad g, Quad b) {
#if defined(__x86_64__)
  const __m128 rg = _mm_unpacklo_ps(__m128(r), __m128(g)), rg2 = _mm_unpackhi_ps(__m128(r), __m128(g));  // r0 g0 r1 g1, ...
  const __m128 br = _mm_shuffle_ps(__m128(b), __m128(r), _MM_SHUFFLE(1, 1, 0, 0));                       // b0 b0 r1 r1
  const __m128 gb = _mm_shuffle_ps(__m128(g), __m128(b), _MM_SHUFFLE(1, 1, 1, 1));                       // g1 g1 b1 b1
  const __m128 br2 = _mm_shuffle_ps(__m128(b), __m128(r), _MM_SHUFFLE(3, 3, 2, 2));                      // b2 b2 r3 r3
  const __m128 gb2 = _mm_shuffle_ps(__m128(g), __m128(b), _MM_SHUFFLE(3, 3, 3, 3));                      // g3 g3 b3 b3
  return {{Quad(_mm_shuffle_ps(rg, br, _MM_SHUFFLE(2, 0, 1, 0))), Quad(_mm_shuffle_ps(gb, rg2, _MM_SHUFFLE(1, 0, 2, 0))),
           Quad(_mm_shuffle_ps(br2, gb2, _MM_SHUFFLE(2, 0, 2, 0)))}};
#else
  return {{{r[0], g[0], b[0], r[1]}, {g[1], b[1], r[2], g[2]}, {b[2], r[3], g[3], b[3]}}};
#endif
}
static_assert(kBlock == 4);

// Four pixels of a block's row, as the image holds them.
struct PixelRun {
  float rgb[3 * kBlock], alpha[kBlock], depth[kBlock];
};

inline Interleaved colours_of_run(const View& view, const BlockState& state, int at) {
  const Quad most = Quad{} + view.brightest;
  Quad colour[3];
  for (int c = 0; c < 3; c++) {
    const Quad sum = load_quad(state.rgb[c] + at);
    colour[c] = sum < most ? sum : most;
  }
  return interleaved(colour[0], colour[1], colour[2]);
}

inline Quad alpha_of_run(const BlockState& state, int at) { return 1.0f - load_quad(state.transmittance + at); }

inline Quad depth_of_run(const View& view, const BlockState& state, int at) {
  return finished_depth(view, load_quad(state.depth + at), alpha_of_run(state, at));
}

inline void write_run(const View& view, const BlockState& state, int at, const Targets& to) {
  if (to.rgb) {
    const Interleaved colours = colours_of_run(view, state, at);
    std::memcpy(to.rgb, &colours, sizeof colours);
  }
  if (to.alpha) store(to.alpha, alpha_of_run(state, at));
  if (to.depth) store(to.depth, depth_of_run(view, state, at));
}

inline Targets moved(const Targets& targets, size_t pixels) {
  const auto from = [pixels](float* p, int channels) { return p ? p + channels * pixels : nullptr; };
  return {from(targets.rgb, 3), from(targets.alpha, 1), from(targets.depth, 1)};
}

inline void write_rows(const View& view, const TileArea& area, const BlockState* blocks, const Targets& targets) {
  for (int y = 0; y < area.height; y++)
    for (int x = 0; x < area.width; x += kBlock) {
      const BlockState& state = blocks[y / kBlock * kBlocksPerSide + x / kBlock];
      const Targets to = moved(targets, size_t(area.y + y) * view.width + area.x + x);
      const int n = area.width - x, at = y % kBlock * kBlock;
      if (n >= kBlock) {
        write_run(view, state, at, to);
        continue;
      }
      PixelRun run;
      write_run(view, state, at, {run.rgb, run.alpha, run.depth});
      if (to.rgb) std::memcpy(to.rgb, run.rgb, 3 * n * sizeof(float));
      if (to.alpha) std::memcpy(to.alpha, run.alpha, n * sizeof(float));
      if (to.depth) std::memcpy(to.depth, run.depth, n * sizeof(float));
    }
}

// Rows of whole cache lines, each target's without a break, so that no line is written in two goes.
inline void stream_rows(const View& view, const TileArea& area, const BlockState* blocks, const Targets& targets) {
  for (int y = 0; y < area.height; y++) {
    const BlockState* row = blocks + y / kBlock * kBlocksPerSide;
    const Targets to = moved(targets, size_t(area.y + y) * view.width + area.x);
    const int n = area.width / kBlock, at = y % kBlock * kBlock;
    for (int i = 0; to.rgb && i < n; i++) {
      const Interleaved colours = colours_of_run(view, row[i], at);
      for (int k = 0; k < 3; k++) stream(to.rgb + (3 * i + k) * kBlock, colours.part[k]);
    }
    for (int i = 0; to.alpha && i < n; i++) stream(to.alpha + i * kBlock, alpha_of_run(row[i], at));
    for (int i = 0; to.depth && i < n; i++) stream(to.depth + i * kBlock, depth_of_run(view, row[i], at));
  }
  end_streaming();
}

// Large pictures of whole cache lines a tile's row go past the caches, where they would not be found again anyway.
inline bool streams(const View& view, const Targets& targets) {
  const auto whole_lines = [](const float* p) { return reinterpret_cast<uintptr_t>(p) % kLineBytes == 0; };
  return int64_t(view.width) * view.height >= kLeastStreamedPixels && view.width % (kLineBytes / sizeof(float)) == 0 &&
         whole_lines(targets.rgb) && whole_lines(targets.alpha) && whole_lines(targets.depth);
}

inline void write_tile(const View& view, const TileArea& area, const BlockState* blocks, const Targets& targets) {
  streams(view, targets) ? stream_rows(view, area, blocks, targets) : write_rows(view, area, blocks, targets);
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

}  // namespace
}  // namespace cags::raster
