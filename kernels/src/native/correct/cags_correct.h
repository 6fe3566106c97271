// The C interface of the client's last step: what a server says is lacking, brought to the client's view by depth and laid over
// it; see cags_common.correction for what it computes.
#pragma once
#include "cags_kernels.h"

struct CagsLackInput {
  const float* coded;  // [height, width, 3] in [0, 1]
  const float* own;  // [height, width, 3], the client's render from the reference camera: `coded` is a picture; null: a companded
                     // difference
  int32_t width, height;
  float knee;   // of the difference
  float error;  // mean squared error that coding has left in the picture
  int32_t threads;
  int64_t coded_length, own_length;  // floats; 0 where there is none
};

struct CagsAddInput {
  const float *rgb, *alpha, *depth;  // [height, width, 3], [height, width] twice: the client's view
  const int16_t* lack;               // as cags_lack makes it, of reference_width x reference_height
  const float* veto;                 // [height, width] or [ceil(height / 16), ceil(width / 16)] in [0, 1], or null
  int32_t width, height, reference_width, reference_height;
  float m[9], b[3];      // client pixel (u, v) of depth D lies at (m [u, v, 1] D + b), homogeneous, in the reference
  float cell_x, cell_y;  // client pixels a reference pixel
  int32_t stride;        // every stride-th pixel of every stride-th row may hide others
  float depth_tolerance, slope_cells, border_px, hole_alpha;
  int32_t coarse_veto;  // whether the veto's values are of cells of 16 x 16 pixels
  int32_t threads;
  int64_t rgb_length, alpha_length, depth_length, lack_length, veto_length;  // values
};

// What is lacking, in units of 1 / 32767, with the edge repeated once around it, ready to be sampled: of each pixel but the last
// of a row the values and those of the pixel to the right, [height + 2, width + 1, 4, 2]; the fourth lane is the opacity.
// `length` is of `lack`, in values.
CAGS_API int32_t cags_lack(const CagsLackInput* input, int16_t* lack, int64_t length);
// The frame [height, width, 3] in [0, 1], and how much of what is lacking was added [height, width].
CAGS_API int32_t cags_add_lack(const CagsAddInput* input, float* shown, int64_t shown_length, float* confidence,
                               int64_t confidence_length);
