// The C interface of alignment (PRPA) and closed-form restoration; see cags_client.align and cags_client.restore.affine.
#pragma once
#include "cags_kernels.h"

// A reference picture, and how a client's pixels lie in it: pixel (u, v) of depth D at (m [u, v, 1] D + b), homogeneous.
struct CagsAlignInput {
  const float* depth;      // [height, width] camera-space z; what is not finite or not positive is void
  const float* reference;  // [reference_height, reference_width, 3]
  int32_t width, height, reference_width, reference_height;
  float m[9], b[3];
  float cell_x, cell_y;  // client pixels a reference pixel
  float depth_tolerance, slope_cells, border_px;
  int32_t erosion_radius, erosion_iterations, threads;
};

struct CagsAlignOutput {
  float* rgb;         // [height, width, 3]; null: only the geometry is wanted
  float* confidence;  // [height, width]
  uint8_t* occluded;  // [height, width]: 0 or 1
  float* x;           // [height, width] reference pixels, 0 where the pixel is not in the reference
  float* y;
};

struct CagsCorrectInput {
  const float* own;        // [reference_height, reference_width, 3]: the client's splats seen from the reference
  const float* reference;  // the same size
  int32_t reference_width, reference_height;
  int32_t radius_cells;
  float gain_prior, noise, detail_noise;
  const float* distorted;  // [height, width, 3]
  const float* confidence;  // [height, width]
  const float* x;
  const float* y;
  int32_t width, height, threads;
};

CAGS_API int32_t cags_align(const CagsAlignInput* input, const CagsAlignOutput* output);
CAGS_API int32_t cags_correct(const CagsCorrectInput* input, float* restored);  // [height, width, 3] in [0, 1]
