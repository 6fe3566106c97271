// Colours of a block of splats from spherical harmonics, in the direction from the camera.
#pragma once
#include "raster/layout.h"
#include "raster/stages/vector.h"

namespace cags::raster {
namespace {

constexpr int kRestOfDegree[] = {0, 3, 8, 15};

// The real spherical harmonics of degrees 1 to 3 in a unit direction, with the signs and order of Kerbl et al. 2023.
inline void harmonics(int degree, Floats x, Floats y, Floats z, Floats* out) {
  out[0] = -0.48860251f * y, out[1] = 0.48860251f * z, out[2] = -0.48860251f * x;
  if (degree < 2) return;
  const Floats xx = x * x, yy = y * y, zz = z * z;
  out[3] = 1.0925484f * x * y, out[4] = -1.0925484f * y * z, out[5] = 0.31539157f * (2.0f * zz - xx - yy);
  out[6] = -1.0925484f * x * z, out[7] = 0.54627422f * (xx - yy);
  if (degree < 3) return;
  out[8] = -0.59004359f * y * (3.0f * xx - yy), out[9] = 2.8906114f * x * y * z;
  out[10] = -0.45704580f * y * (4.0f * zz - xx - yy), out[11] = 0.37317633f * z * (2.0f * zz - 3.0f * xx - 3.0f * yy);
  out[12] = -0.45704580f * x * (4.0f * zz - xx - yy), out[13] = 1.4453057f * z * (xx - yy);
  out[14] = -0.59004359f * x * (xx - 3.0f * yy);
}

inline void evaluate_colours(const SceneData& scene, int degree, int i, const float (*toward)[kLanes], float (*out)[kLanes]) {
  const float* rest = scene.rest + size_t(i / kLanes) * scene.sh_rest * 3 * kLanes;
  for (int lane = 0; lane < kLanes; lane += kWidth) {
    Floats rgb[3], basis[15];
    for (int c = 0; c < 3; c++) rgb[c] = load(scene.base[c] + i + lane);
    if (degree > 0) {
      const Floats x = load(toward[0] + lane), y = load(toward[1] + lane), z = load(toward[2] + lane);
      const Floats inverse = 1.0f / square_root(greater(x * x + y * y + z * z, all(1e-30f)));
      harmonics(degree, x * inverse, y * inverse, z * inverse, basis);
      for (int k = 0; k < kRestOfDegree[degree]; k++)
        for (int c = 0; c < 3; c++) rgb[c] += basis[k] * load(rest + (3 * k + c) * kLanes + lane);
    }
    for (int c = 0; c < 3; c++) store(out[c] + lane, greater(rgb[c], all(0.0f)));
  }
}

// The colours of a block of splats as the view sees them.
inline void colours_of(const SceneData& scene, const View& view, int i, const float (*toward)[kLanes], Colours& out) {
  const int present = scene.degree[i / kLanes];
  evaluate_colours(scene, present < view.sh_degree ? present : view.sh_degree, i, toward, out.rgb);
}

}  // namespace
}  // namespace cags::raster
