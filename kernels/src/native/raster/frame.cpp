#include "raster/frame.h"

#include "raster/stages.h"
#include "support/float_mode.h"
#include "support/instruction_set.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <limits>

namespace cags::raster {
namespace {

constexpr int kMinChunk = 2048;  // splats: less is not worth a thread's while
constexpr int kMaxChunks = 64;   // bounds the counters a tile

// Largest transmittance at which a block is given up, by level.
float stop_of(int exactness) {
  switch (exactness) {
    case CAGS_FAST: return 1.0f / 255;
    case CAGS_BALANCED: return 1e-4f;
    default: return 1e-6f;
  }
}

class Stopwatch {
 public:
  double lap_ms() {
    const auto now = std::chrono::steady_clock::now();
    return std::chrono::duration<double, std::milli>(now - std::exchange(last_, now)).count();
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

}  // namespace

const Stages& active_stages() { return in_use(CAGS_VARIANTS(stages)); }

View make_view(const CagsCamera& camera, const CagsRasterOptions& options) {
  View view{};
  std::copy_n(camera.rotation, 9, view.rotation);
  std::copy_n(camera.position, 3, view.position);
  view.fx = camera.fx, view.fy = camera.fy, view.cx = camera.cx - 0.5, view.cy = camera.cy - 0.5;
  view.near_plane = float(camera.near_plane);
  view.limit_x = kJacobianMargin * float(0.5 * camera.width / camera.fx);
  view.limit_y = kJacobianMargin * float(0.5 * camera.height / camera.fy);
  view.dilation = options.dilation, view.variance = options.dilation + options.filter;
  view.width = camera.width, view.height = camera.height;
  view.tiles_x = (camera.width + kTile - 1) / kTile, view.tiles_y = (camera.height + kTile - 1) / kTile;
  view.sh_degree = options.max_sh_degree, view.exactness = options.exactness, view.depth = options.depth;
  view.brightest = options.brightest, view.void_alpha = options.void_alpha, view.stop = stop_of(options.exactness);
  return view;
}

void Frame::run(const Scene& scene, const View& view, const CagsRasterTargets& targets, int threads,
                CagsRasterStatistics* statistics) {
  const Stages& stages = active_stages();
  const SceneData splats = scene.data();
  Stopwatch watch;
  prepare(splats, view);
  parallel_for(threads, data_.chunks, [&](int chunk, int) {
    FlushDenormals mode;
    stages.project(splats, view, data_, chunk);
  });
  const double project_ms = watch.lap_ms();
  place_entries(view);
  parallel_for(threads, data_.chunks, [&](int chunk, int) { stages.scatter(view, data_, chunk); });
  prepare_tiles(view, targets.contribution, threads, stages.work_bytes);
  const double bin_ms = watch.lap_ms();
  const Targets pixels{targets.rgb, targets.alpha, targets.depth};
  parallel_for(threads, view.tiles_x * view.tiles_y, [&](int index, int worker) {
    FlushDenormals mode;
    stages.composite(view, data_, pixels, scratch_[worker], tile_order_[index]);
  });
  if (targets.contribution) reduce(splats, targets.contribution, threads);
  if (!statistics) return;
  *statistics = {project_ms, bin_ms, watch.lap_ms(), 0, int64_t(data_.tile_start[view.tiles_x * view.tiles_y]), 0};
  for (int chunk = 0; chunk < data_.chunks; chunk++) statistics->visible += data_.chunk_records[chunk];
  for (const TileScratch& scratch : scratch_) statistics->block_visits += scratch.block_visits;
}

void Frame::prepare(const SceneData& scene, const View& view) {
  const int tiles = view.tiles_x * view.tiles_y;
  const int even_share = (scene.padded + kMaxChunks - 1) / kMaxChunks;
  data_.chunk_size = std::max(kMinChunk, (even_share + kLanes - 1) / kLanes * kLanes);
  data_.chunks = (scene.padded + data_.chunk_size - 1) / data_.chunk_size;
  const size_t rows = size_t(data_.chunks) * data_.chunk_size;
  data_.records = records_.reserve(rows), data_.splat = splat_.reserve(rows);
  data_.chunk_records = chunk_records_.reserve(data_.chunks);
  data_.chunk_slot = chunk_slot_.reserve(data_.chunks + 1);
  data_.tile_cursor = tile_cursor_.reserve(size_t(data_.chunks) * tiles);
  data_.tile_start = tile_start_.reserve(tiles + 1);
}

// Turns counts into places: where each tile's list starts, where each chunk writes in it, where each chunk's slots start.
void Frame::place_entries(const View& view) {
  const int tiles = view.tiles_x * view.tiles_y;
  uint64_t total = 0;  // of the counts a tile and chunk, which cannot overflow: a chunk's own sum may have
  for (size_t i = 0; i < size_t(data_.chunks) * tiles; i++) total += data_.tile_cursor[i];
  if (total > std::numeric_limits<uint32_t>::max()) throw std::bad_alloc();
  uint32_t slot = 0, place = 0;
  for (int chunk = 0; chunk < data_.chunks; chunk++) slot += std::exchange(data_.chunk_slot[chunk], slot);
  for (int tile = 0; tile < tiles; tile++) {
    data_.tile_start[tile] = place;
    for (int chunk = 0; chunk < data_.chunks; chunk++) {
      uint32_t& cursor = data_.tile_cursor[size_t(chunk) * tiles + tile];
      place += std::exchange(cursor, place);
    }
  }
  data_.tile_start[tiles] = place;
  data_.entries = entries_.reserve(place);
}

// Fullest tiles first: the threads then finish together.
void Frame::order_tiles(int tiles) {
  int32_t* order = tile_order_.reserve(tiles);
  for (int i = 0; i < tiles; i++) order[i] = i;
  auto size = [&](int tile) { return data_.tile_start[tile + 1] - data_.tile_start[tile]; };
  std::sort(order, order + tiles, [&](int a, int b) { return size(a) != size(b) ? size(a) > size(b) : a < b; });
}

void Frame::prepare_tiles(const View& view, bool contribution, int threads, size_t work_bytes) {
  const int tiles = view.tiles_x * view.tiles_y;
  order_tiles(tiles);
  const size_t fullest = data_.tile_start[tile_order_[0] + 1] - data_.tile_start[tile_order_[0]];
  while (int(workers_.size()) < threads) workers_.push_back(std::make_unique<Worker>());
  scratch_.assign(threads, {});
  for (int i = 0; i < threads; i++) scratch_[i] = {workers_[i]->spare.reserve(fullest), workers_[i]->work.reserve(work_bytes), 0};
  data_.slots = contribution ? slots_.reserve(data_.tile_start[tiles]) : nullptr;
}

// Adds up each splat's slots, always in the same order: the sums do not depend on the number of threads.
void Frame::reduce(const SceneData& scene, float* contribution, int threads) {
  std::fill_n(contribution, scene.count, 0.0f);
  parallel_for(threads, data_.chunks, [&](int chunk, int) {
    const int begin = chunk * data_.chunk_size, end = begin + data_.chunk_records[chunk];
    const float* slot = data_.slots + data_.chunk_slot[chunk];
    for (int i = begin; i < end; i++) {
      const Record& r = data_.records[i];
      const int count = (r.tile_x1 - r.tile_x0 + 1) * (r.tile_y1 - r.tile_y0 + 1);
      float total = 0.0f;
      for (int k = 0; k < count; k++) total += *slot++;
      contribution[data_.splat[i]] = total;
    }
  });
}

}  // namespace cags::raster
