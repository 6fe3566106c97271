#include "cags_kernels.h"
#include "raster/frame.h"
#include "raster/stages.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <limits>
#include <memory>
#include <mutex>
#include <new>
#include <vector>

using cags::raster::Frame;

// A scene with the frames that are not in use: renders beside each other each take their own.
struct CagsRasterScene {
  CagsRasterScene(const CagsSplats& splats, int threads) : scene(splats, threads) {}

  std::unique_ptr<Frame> take_frame() {
    std::lock_guard lock(mutex);
    if (idle.empty()) return std::make_unique<Frame>();
    std::unique_ptr<Frame> frame = std::move(idle.back());
    idle.pop_back();
    return frame;
  }
  void give_back(std::unique_ptr<Frame> frame) {
    std::lock_guard lock(mutex);
    idle.push_back(std::move(frame));
  }

  cags::raster::Scene scene;
  std::mutex mutex;
  std::vector<std::unique_ptr<Frame>> idle;
};

namespace {

constexpr int kMaxSide = 16384;  // pixels
constexpr int64_t kMaxSplats = std::numeric_limits<int32_t>::max() / 64;

template <typename Body>
int32_t guarded(const Body& body) {
  try {
    return body();
  } catch (const std::bad_alloc&) {
    return CAGS_OUT_OF_MEMORY;
  } catch (...) {
    return CAGS_FAILED;
  }
}

bool valid(const CagsSplats& splats) {
  const int k = splats.sh_rest_count;
  return splats.count >= 0 && splats.count <= kMaxSplats && (k == 0 || k == 3 || k == 8 || k == 15);
}

bool valid(const CagsCamera& camera, const CagsRasterOptions& options) {
  return camera.width >= 1 && camera.width <= kMaxSide && camera.height >= 1 && camera.height <= kMaxSide && camera.fx > 0 &&
         camera.fy > 0 && camera.near_plane > 0 && options.threads >= 1 && options.exactness >= CAGS_FAST &&
         options.exactness <= CAGS_EXACT && options.depth >= CAGS_DEPTH_NONE && options.depth <= CAGS_DEPTH_MEDIAN &&
         options.max_sh_degree >= 0 && options.dilation >= 0 && options.filter >= 0 && options.dilation + options.filter > 0;
}

int32_t run(CagsRasterScene* scene, const CagsCamera& camera, const CagsRasterOptions& options,
            const cags::raster::Targets& targets, const cags::raster::SplatSums& sums, CagsRasterStatistics* statistics) {
  if (!valid(camera, options)) return CAGS_INVALID;
  return guarded([&] {
    std::unique_ptr<Frame> frame = scene->take_frame();
    const int threads = std::min(options.threads, cags::kMaxThreads);
    frame->run(scene->scene, cags::raster::make_view(camera, options), targets, sums, threads, statistics);
    scene->give_back(std::move(frame));
    return CAGS_OK;
  });
}

}  // namespace

int32_t cags_raster_scene_create(const CagsSplats* splats, int32_t threads, CagsRasterScene** scene) {
  if (!valid(*splats) || threads < 1) return CAGS_INVALID;
  return guarded([&] {
    *scene = new CagsRasterScene(*splats, std::min(threads, cags::kMaxThreads));
    return CAGS_OK;
  });
}

void cags_raster_scene_destroy(CagsRasterScene* scene) { delete scene; }

int32_t cags_raster_scene_update(CagsRasterScene* scene, const int64_t* rows, const CagsSplats* splats) {
  if (!valid(*splats) || splats->sh_rest_count != scene->scene.data().sh_rest) return CAGS_INVALID;
  auto inside = [&](int64_t row) { return row >= 0 && row < scene->scene.count(); };
  if (!std::all_of(rows, rows + splats->count, inside)) return CAGS_INVALID;
  scene->scene.update(rows, *splats);
  return CAGS_OK;
}

int32_t cags_raster_render(CagsRasterScene* scene, const CagsCamera* camera, const CagsRasterOptions* options,
                           const CagsRasterTargets* targets, CagsRasterStatistics* statistics) {
  cags::raster::SplatSums sums;
  if (targets->contribution) sums = {1, 1, targets->contribution, nullptr};
  return run(scene, *camera, *options, {targets->rgb, targets->alpha, targets->depth, nullptr}, sums, statistics);
}

int32_t cags_raster_back_project(CagsRasterScene* scene, const CagsCamera* camera, const CagsRasterOptions* options,
                                 const float* residual, float* weighted_residual, float* weight) {
  if (!residual) return CAGS_INVALID;
  return run(scene, *camera, *options, {nullptr, nullptr, nullptr, residual}, {4, 3, weighted_residual, weight}, nullptr);
}

double cags_multiply_adds(int64_t rounds) { return cags::raster::active_stages().multiply_adds(rounds); }
