// Splats in the layout that the stages read, kept between frames and updated in part.
#pragma once
#include "cags_kernels.h"
#include "raster/layout.h"
#include "support/aligned.h"

namespace cags::raster {

class Scene {
 public:
  // Copies the splats. Throws std::bad_alloc.
  Scene(const CagsSplats& splats, int threads);

  // Whether the splats of `all`, one for each of the scene, can be drawn as they are to be at `rows`: with their looks, or where
  // they only moved.
  bool drawable(const int64_t* rows, int64_t count, const CagsSplats& all, int threads, bool looks) const;
  // Takes the splats at rising `rows` from `all`, of as many SH coefficients. Not beside a render, as the next one.
  void update(const int64_t* rows, int64_t count, const CagsSplats& all, int threads);
  // Takes position, rotation and opacity of those at rising `rows` from `all`; nothing else is looked at there.
  void move(const int64_t* rows, int64_t count, const CagsSplats& all, int threads);

  int count() const { return count_; }
  SceneData data() const;

 private:
  void store(int slot, const CagsSplats& splats, int64_t row);
  void place(int slot, const CagsSplats& splats, int64_t row);
  void refresh_degree(int block);

  int count_, padded_, sh_rest_;
  AlignedArray<float> geometry_;  // mean, axes, log2_opacity, base: planes of padded_
  AlignedArray<float> rest_;
  AlignedArray<float> scale_, logit_;  // splat by splat: what need not be worked out again where one only moves
  AlignedArray<uint32_t> tie_;
  AlignedArray<uint32_t> looks_;  // hash of what stays where a splat only moves
  AlignedArray<uint8_t> degree_;
};

}  // namespace cags::raster
