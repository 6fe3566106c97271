// One tile: order its splats, take them in batches, cover, blend, write the pixels.
#pragma once
#include "raster/stages/blend.h"
#include "raster/stages/cover.h"
#include "raster/stages/image.h"
#include "raster/stages/order.h"

namespace cags::raster {
namespace {

constexpr int kPrefetchAhead = 24;  // records

struct TileWork {
  Local local[kBatch];
  Ellipses ellipses;
  Membership membership;
  BlockState blocks[kBlocks];
  Run run;
  float sums[kBatch];
};

// Brings records of the sorted entries [first, first + n) into the tile's frame.
inline void gather(const FrameData& frame, const uint64_t* sorted, int first, int n, int total, const TileArea& area,
                   TileWork& work) {
  for (int i = 0; i < n; i++) {
    if (first + i + kPrefetchAhead < total) __builtin_prefetch(frame.records + uint32_t(sorted[first + i + kPrefetchAhead]));
    const Record& r = frame.records[uint32_t(sorted[first + i])];
    const float x = (r.u - float(area.x)) + r.u_rest, y = (r.v - float(area.y)) + r.v_rest;
    work.local[i] = {r.l11, r.l12, -(r.l11 * x + r.l12 * y), r.l22, -r.l22 * y, r.log2_opacity, r.r, r.g, r.b, r.z};
    work.ellipses.x[i] = x, work.ellipses.y[i] = y, work.ellipses.reach[i] = r.log2_opacity - kLog2AlphaCut;
    work.ellipses.l11[i] = r.l11, work.ellipses.l12[i] = r.l12, work.ellipses.l22[i] = r.l22;
  }
  for (int i = n; i % kWordBits; i++) {  // ellipses far above the tile reach nothing
    work.ellipses.x[i] = 0, work.ellipses.y[i] = -1e4f, work.ellipses.reach[i] = 0;
    work.ellipses.l11[i] = work.ellipses.l22[i] = 1, work.ellipses.l12[i] = 0;
  }
}

// Clears the blocks; pixels beyond the image transmit nothing, so that they weigh nothing. Returns the blocks in the image.
inline uint64_t begin_blocks(const TileArea& area, TileWork& work) {
  uint64_t alive = 0;
  for (int block = 0; block < kBlocks; block++) {
    const int x = block % kBlocksPerSide * kBlock, y = block / kBlocksPerSide * kBlock;
    if (x >= area.width || y >= area.height) continue;
    alive |= uint64_t{1} << block;
    BlockState& state = work.blocks[block];
    for (int i = 0; i < kBlockPixels; i += kWidth) {
      store(state.transmittance + i, all(1.0f)), store(state.depth + i, Floats{});
      for (int c = 0; c < 3; c++) store(state.rgb[c] + i, Floats{});
    }
    if (x + kBlock <= area.width && y + kBlock <= area.height) continue;
    for (int pixel = 0; pixel < kBlockPixels; pixel++)
      if (x + pixel % kBlock >= area.width || y + pixel / kBlock >= area.height) state.transmittance[pixel] = 0.0f;
  }
  return alive;
}

inline float* slot_of(const FrameData& frame, const View& view, uint32_t record, int tile) {
  const Record& r = frame.records[record];
  const uint32_t column = uint32_t(tile % view.tiles_x - r.tile_x0), row = uint32_t(tile / view.tiles_x - r.tile_y0);
  const size_t slot =
      size_t(frame.chunk_slot[record / uint32_t(frame.chunk_size)]) + r.slot + row * uint32_t(r.tile_x1 - r.tile_x0 + 1) + column;
  return frame.slots + slot;
}

inline void write_slots(const FrameData& frame, const View& view, const uint64_t* sorted, int n, int tile, const float* sums) {
  for (int i = 0; i < n; i++) *slot_of(frame, view, uint32_t(sorted[i]), tile) = sums ? sums[i] : 0.0f;
}

using Blend = uint8_t (*)(const BlendInput&, const uint8_t* reached, int row, uint8_t alive, BlockState*, Run&, int64_t& visits);

// Blends a batch of `n` splats into the blocks in `alive`, word by word and row by row. Returns those that are not finished.
inline uint64_t blend_batch(const View& view, int n, uint64_t alive, Blend blend, TileWork& work, int64_t& visits) {
  for (int first = 0; first < n && alive; first += kWordBits) {
    const BlendInput input{work.local + first, view.stop, work.sums + first};
    for (int row = 0; row < kBlocksPerSide; row++) {
      const int shift = row * kBlocksPerSide;
      const uint8_t left = uint8_t(alive >> shift);
      if (!left) continue;
      const uint8_t done = blend(input, work.membership.row[row] + first, row, left, work.blocks + shift, work.run, visits);
      alive &= ~(uint64_t{done} << shift);
    }
  }
  return alive;
}

// Runs `blend` over all batches of the tile.
inline void blend_tile(const View& view, const FrameData& frame, TileScratch& scratch, int tile, uint64_t alive, Blend blend) {
  TileWork& work = *static_cast<TileWork*>(scratch.work);
  const TileArea area = area_of(view, tile);
  const int n = int(frame.tile_start[tile + 1] - frame.tile_start[tile]);
  const uint64_t* sorted = order(frame.entries + frame.tile_start[tile], scratch.spare, n, frame.records);
  int first = 0;
  for (; first < n && alive; first += kBatch) {
    const int batch = n - first < kBatch ? n - first : kBatch;
    gather(frame, sorted, first, batch, n, area, work);
    cover(work.ellipses, batch, work.membership);
    if (frame.slots) std::memset(work.sums, 0, sizeof work.sums);
    alive = blend_batch(view, batch, alive, blend, work, scratch.block_visits);
    if (frame.slots) write_slots(frame, view, sorted + first, batch, tile, work.sums);
  }
  if (frame.slots && first < n) write_slots(frame, view, sorted + first, n - first, tile, nullptr);
}

template <int kDegree>
Blend choose_blend(int depth, bool contribution) {
  constexpr Blend table[2][2] = {
      {blend<kDegree, accumulate<CAGS_DEPTH_NONE, false>>, blend<kDegree, accumulate<CAGS_DEPTH_NONE, true>>},
      {blend<kDegree, accumulate<CAGS_DEPTH_EXPECTED, false>>, blend<kDegree, accumulate<CAGS_DEPTH_EXPECTED, true>>},
  };
  return table[depth][contribution];
}

void composite(const View& view, const FrameData& frame, const Targets& targets, TileScratch& scratch, int tile) {
  TileWork& work = *static_cast<TileWork*>(scratch.work);
  const TileArea area = area_of(view, tile);
  if (frame.tile_start[tile] == frame.tile_start[tile + 1]) return write_void(view, area, targets);
  const uint64_t alive = begin_blocks(area, work);
  const bool contribution = frame.slots != nullptr;
  const Blend blend =
      view.exactness == CAGS_EXACT ? choose_blend<5>(view.depth, contribution) : choose_blend<3>(view.depth, contribution);
  blend_tile(view, frame, scratch, tile, alive, blend);
  write_tile(view, area, work.blocks, targets);
}

}  // namespace
}  // namespace cags::raster
