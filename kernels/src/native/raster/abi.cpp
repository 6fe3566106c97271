#include "cags_kernels.h"
#include "raster/frame.h"
#include "raster/stages.h"
#include "support/calls.h"
#include "support/float_mode.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <limits>
#include <memory>
#include <mutex>
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
constexpr float kMaxColourAngle = 1.5f;  // radians: the sine must tell angles apart
constexpr int kStripe = 16;      // rows that a thread brings up to the whole resolution at a time
constexpr int64_t kMaxSplats = std::numeric_limits<int32_t>::max() / 64;

bool valid(const CagsSplats& splats) {
  const int k = splats.sh_rest_count;
  return splats.count >= 0 && splats.count <= kMaxSplats && (k == 0 || k == 3 || k == 8 || k == 15);
}

bool inside(const CagsRasterScene& scene, const int64_t* rows, int64_t count) {
  return std::all_of(rows, rows + count, [&](int64_t row) { return row >= 0 && row < scene.scene.count(); });
}

bool valid(const CagsCamera& camera, const CagsRasterOptions& options) {
  return camera.width >= 1 && camera.width <= kMaxSide && camera.height >= 1 && camera.height <= kMaxSide && camera.fx > 0 &&
         camera.fy > 0 && camera.near_plane > 0 && options.threads >= 1 && options.exactness >= CAGS_FAST &&
         options.exactness <= CAGS_EXACT && options.depth >= CAGS_DEPTH_NONE && options.depth <= CAGS_DEPTH_MEDIAN &&
         options.max_sh_degree >= 0 && options.brightest >= 0 && options.colour_angle >= 0 && options.colour_angle < kMaxColourAngle && options.dilation >= 0 && options.filter >= 0 && options.dilation + options.filter > 0;
}

int32_t run(CagsRasterScene* scene, const CagsCamera& camera, const CagsRasterOptions& options,
            const cags::raster::Targets& targets, const cags::raster::SplatSums& sums, CagsRasterStatistics* statistics) {
  if (!valid(camera, options)) return CAGS_INVALID;
  return cags::guarded([&] {
    std::unique_ptr<Frame> frame = scene->take_frame();
    const int threads = std::min(options.threads, cags::kMaxThreads);
    frame->run(scene->scene, cags::raster::make_view(camera, options), targets, sums, threads, statistics);
    scene->give_back(std::move(frame));
  });
}

}  // namespace

int32_t cags_raster_scene_create(const CagsSplats* splats, int32_t threads, CagsRasterScene** scene) {
  if (!valid(*splats) || threads < 1) return CAGS_INVALID;
  return cags::guarded([&] {
    *scene = new CagsRasterScene(*splats, std::min(threads, cags::kMaxThreads));
  });
}

void cags_raster_scene_destroy(CagsRasterScene* scene) { delete scene; }

int32_t cags_raster_scene_update(CagsRasterScene* scene, const int64_t* rows, const CagsSplats* splats) {
  if (!valid(*splats) || splats->sh_rest_count != scene->scene.data().sh_rest) return CAGS_INVALID;
  if (!inside(*scene, rows, splats->count)) return CAGS_INVALID;
  scene->scene.update(rows, *splats);
  return CAGS_OK;
}

int32_t cags_raster_scene_recolour(CagsRasterScene* scene, const int64_t* rows, int64_t count, const float* sh0) {
  if (count < 0 || !inside(*scene, rows, count)) return CAGS_INVALID;
  scene->scene.recolour(rows, count, sh0);
  return CAGS_OK;
}

int32_t cags_raster_scene_move(CagsRasterScene* scene, const int64_t* rows, int64_t count, const CagsSplats* all, int32_t threads) {
  if (count < 0 || threads < 1 || !inside(*scene, rows, count)) return CAGS_INVALID;
  if (all->count != scene->scene.count() || all->sh_rest_count != scene->scene.data().sh_rest) return CAGS_INVALID;
  threads = std::min(threads, cags::kMaxThreads);
  bool good = false;
  const int32_t status = cags::guarded([&] {
    good = scene->scene.drawable(rows, count, *all, threads);
    if (good) scene->scene.move(rows, count, *all, threads);
  });
  return status == CAGS_OK && !good ? CAGS_INVALID : status;
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

int32_t cags_raster_upsample(const CagsRasterTargets* half, int32_t width, int32_t height, float void_alpha, float brightest,
                             int32_t threads, const CagsRasterTargets* whole) {
  const bool complete = half->rgb && whole->rgb && !half->alpha == !whole->alpha && !half->depth == !whole->depth &&
                        (half->alpha || !half->depth);
  if (!complete || width < 1 || width > kMaxSide || height < 1 || height > kMaxSide || threads < 1) return CAGS_INVALID;
  return cags::guarded([&] {
    const cags::raster::UpsampleJob job{{half->rgb, half->alpha, half->depth, nullptr},
                                        {whole->rgb, whole->alpha, whole->depth, nullptr}, width, height, void_alpha, brightest};
    const int workers = std::min(threads, cags::kMaxThreads), stripes = (height + kStripe - 1) / kStripe;
    const size_t pitch = size_t(width / 2 + 1 + 4) * 3;
    std::vector<float> rows(pitch * workers);
    cags::parallel_for(workers, stripes, [&](int stripe, int worker) {
      cags::FlushDenormals mode;
      for (int y = stripe * kStripe; y < std::min(height, (stripe + 1) * kStripe); y++)
        cags::raster::active_stages().upsample(job, y, rows.data() + worker * pitch);
    });
  });
}

double cags_multiply_adds(int64_t rounds) { return cags::raster::active_stages().multiply_adds(rounds); }
