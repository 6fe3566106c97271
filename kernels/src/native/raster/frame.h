// One frame: runs the stages over chunks and tiles on the thread pool. Its memory is kept for the next frame.
#pragma once
#include "cags_kernels.h"
#include "raster/layout.h"
#include "raster/scene.h"
#include "support/aligned.h"

#include <memory>
#include <vector>

namespace cags::raster {

View make_view(const CagsCamera& camera, const CagsRasterOptions& options);

class Frame {
 public:
  // Throws std::bad_alloc.
  void run(const Scene& scene, const View& view, const CagsRasterTargets& targets, int threads, CagsRasterStatistics* statistics);

 private:
  void prepare(const SceneData& scene, const View& view);
  void place_entries(const View& view);
  void order_tiles(int tiles);
  void prepare_tiles(const View& view, bool contribution, int threads, size_t work_bytes);
  void reduce(const SceneData& scene, float* contribution, int threads);

  FrameData data_{};
  AlignedArray<Record> records_;
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
