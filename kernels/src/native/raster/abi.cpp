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
constexpr int kStripe = 16;      // rows that a thread brings up to the whole resolution at a time
constexpr int64_t kMaxSplats = std::numeric_limits<int32_t>::max() / 64;

bool valid(const CagsSplats& splats) {
  const int k = splats.sh_rest_count;
  if (splats.count < 0 || splats.count > kMaxSplats || !(k == 0 || k == 3 || k == 8 || k == 15)) return false;
  const int64_t each[] = {3, 4, 3, 1, 3, 3 * k};
  return std::equal(each, each + 6, splats.lengths,
                    [&](int64_t floats, int64_t length) { return length == floats * splats.count; });
}

// Whether each target is of the view's size, or not there.
bool fits(const CagsRasterTargets& to, const CagsCamera& camera, int64_t splats) {
  const int64_t pixels = int64_t{camera.width} * camera.height;
  auto fit = [](const float* target, int64_t length, int64_t wanted) { return length == (target ? wanted : 0); };
  return fit(to.rgb, to.lengths[0], 3 * pixels) && fit(to.alpha, to.lengths[1], pixels) && fit(to.depth, to.lengths[2], pixels) &&
         fit(to.contribution, to.lengths[3], splats);
}

bool inside(const CagsRasterScene& scene, const int64_t* rows, int64_t count) {
  return std::all_of(rows, rows + count, [&](int64_t row) { return row >= 0 && row < scene.scene.count(); });
}

// Takes the splats at `rows` from `all`: with their looks, or where they only moved.
int32_t change(CagsRasterScene& held, const int64_t* rows, int64_t count, const CagsSplats& all, int threads, bool looks) {
  cags::raster::Scene& scene = held.scene;
  if (count < 0 || threads < 1 || !inside(held, rows, count)) return CAGS_INVALID;
  if (!valid(all) || all.count != scene.count() || all.sh_rest_count != scene.data().sh_rest) return CAGS_INVALID;
  threads = std::min(threads, cags::kMaxThreads);
  bool good = false;
  const int32_t status = cags::guarded([&] {
    good = scene.drawable(rows, count, all, threads, looks);
    if (good && looks) scene.update(rows, count, all, threads);
    if (good && !looks) scene.move(rows, count, all, threads);
  });
  return status == CAGS_OK && !good ? CAGS_INVALID : status;
}

bool valid(const CagsCamera& camera, const CagsRasterOptions& options) {
  return camera.width >= 1 && camera.width <= kMaxSide && camera.height >= 1 && camera.height <= kMaxSide && camera.fx > 0 &&
         camera.fy > 0 && camera.near_plane > 0 && options.threads >= 1 && options.exactness >= CAGS_FAST &&
         options.exactness <= CAGS_EXACT && options.depth >= CAGS_DEPTH_NONE && options.depth <= CAGS_DEPTH_EXPECTED &&
         options.max_sh_degree >= 0 && options.brightest >= 0 && options.dilation >= 0 && options.filter >= 0 &&
         options.dilation + options.filter > 0;
}

}  // namespace

int32_t cags_raster_scene_create(const CagsSplats* splats, int32_t threads, CagsRasterScene** scene) {
  if (!valid(*splats) || threads < 1) return CAGS_INVALID;
  return cags::guarded([&] { *scene = new CagsRasterScene(*splats, std::min(threads, cags::kMaxThreads)); });
}

void cags_raster_scene_destroy(CagsRasterScene* scene) { delete scene; }

int32_t cags_raster_scene_update(CagsRasterScene* scene, const int64_t* rows, int64_t count, const CagsSplats* all,
                                 int32_t threads) {
  return change(*scene, rows, count, *all, threads, true);
}

int32_t cags_raster_scene_move(CagsRasterScene* scene, const int64_t* rows, int64_t count, const CagsSplats* all,
                               int32_t threads) {
  return change(*scene, rows, count, *all, threads, false);
}

int32_t cags_raster_render(CagsRasterScene* scene, const CagsCamera* camera, const CagsRasterOptions* options,
                           const CagsRasterTargets* targets, CagsRasterStatistics* statistics) {
  if (!valid(*camera, *options) || !fits(*targets, *camera, scene->scene.count())) return CAGS_INVALID;
  return cags::guarded([&] {
    std::unique_ptr<Frame> frame = scene->take_frame();
    const int threads = std::min(options->threads, cags::kMaxThreads);
    frame->run(scene->scene, cags::raster::make_view(*camera, *options), *targets, threads, statistics);
    scene->give_back(std::move(frame));
  });
}

int32_t cags_enlarge(const float* half, int64_t half_length, int32_t width, int32_t height, int32_t threads, float* whole,
                     int64_t whole_length) {
  if (!half || !whole || width < 1 || width > kMaxSide || height < 1 || height > kMaxSide || threads < 1) return CAGS_INVALID;
  if (half_length != int64_t{(width + 1) / 2} * ((height + 1) / 2) * 3 || whole_length != int64_t{width} * height * 3)
    return CAGS_INVALID;
  return cags::guarded([&] {
    const cags::raster::EnlargeJob job{half, whole, width, height};
    const int workers = std::min(threads, cags::kMaxThreads), stripes = (height + kStripe - 1) / kStripe;
    const size_t pitch = size_t(width / 2 + 1 + 4) * 3;
    std::vector<float> rows(pitch * workers);
    cags::parallel_for(workers, stripes, [&](int stripe, int worker) {
      cags::FlushDenormals mode;
      for (int y = stripe * kStripe; y < std::min(height, (stripe + 1) * kStripe); y++)
        cags::raster::active_stages().enlarge(job, y, rows.data() + worker * pitch);
    });
  });
}

double cags_multiply_adds(int64_t rounds) { return cags::raster::active_stages().multiply_adds(rounds); }
