// One frame: runs the stages over chunks and tiles on the thread pool. Its memory is kept for the next frame.
#pragma once
#include "cags_kernels.h"
#include "raster/layout.h"
#include "raster/scene.h"
#include "support/aligned.h"

#include <memory>
#include <vector>

namespace cags::raster {

// Sums a splat gets from a frame: `width` floats a splat (1 or 4), the first `split` to `first`, the rest to `second`.
struct SplatSums {
  int width = 0, split = 0;
  float *first = nullptr, *second = nullptr;
};

View make_view(const CagsCamera& camera, const CagsRasterOptions& options);

class Frame {
 public:
  // Renders, or with targets.residual back-projects. Throws std::bad_alloc.
  void run(const Scene& scene, const View& view, const Targets& targets, const SplatSums& sums, int threads,
           CagsRasterStatistics* statistics);

 private:
  void prepare(const SceneData& scene, const View& view);
  void prepare_colours(const SceneData& scene, const View& view);
  void place_entries(const View& view);
  void order_tiles(int tiles);
  void prepare_tiles(const View& view, const SplatSums& sums, int threads, size_t work_bytes);
  void reduce(const SceneData& scene, const SplatSums& sums, int threads);

  FrameData data_{};
  AlignedArray<Record> records_;
  AlignedArray<CachedColours> colours_;
  int cached_blocks_ = 0;
  AlignedArray<int32_t> splat_, chunk_records_, tile_order_;
  AlignedArray<uint32_t> tile_cursor_, tile_start_, chunk_slot_;
  AlignedArray<uint64_t> entries_;
  AlignedArray<float> slots_;
  struct Worker {
    AlignedArray<uint64_t> spare;
    AlignedArray<unsigned char> work;
  };
  std::vector<std::unique_ptr<Worker>> workers_;
  std::vector<TileScratch> scratch_;
};

}  // namespace cags::raster
