// The C interface of alignment (PRPA) and closed-form restoration; see cags_client.align and cags_client.restore.affine.
#pragma once
#include "cags_kernels.h"

// How a client's pixels lie in a reference: pixel (u, v) of depth D at (m [u, v, 1] D + b), homogeneous.
struct CagsReprojection {
  const float* depth;  // [height, width] camera-space z; what is not finite or not positive is void
  int32_t width, height, reference_width, reference_height;
  float m[9], b[3];
};

struct CagsAlignInput {
  CagsReprojection view;
  const float* reference;  // [reference_height, reference_width, 3]; read for colours alone
  float cell_x, cell_y;    // client pixels a reference pixel
  int32_t stride;          // every stride-th pixel of every stride-th row may hide others
  float depth_tolerance, slope_cells, border_px;
  int32_t erosion_radius, erosion_iterations, threads;
};

struct CagsAlignOutput {
  float* confidence;  // [height, width]
  uint8_t* occluded;  // [height, width]: 0 or 1
  float* rgb;         // [height, width, 3] with what is occluded filled by erosion; or null: no colours are read
};

struct CagsCorrectInput {
  CagsReprojection view;
  const float* own;        // [reference_height, reference_width, 3]: the client's splats seen from the reference
  const float* reference;  // the same size
  int32_t radius_cells;
  float gain_prior;
  float fine_noise[3], broad_noise[3];  // luma and chromas, see cags_common.video.noise
  const float* fields;      // [reference_height, reference_width, 4] to correct by, or null: those of cags_fields
  const float* distorted;   // [height, width, 3]
  const float* confidence;  // [height, width]
  int32_t block_px;         // side of the client's blocks that are compared with `own`
  float misregistration;    // weight of what they disagree by against the correction; 0: not looked at
  float veil;               // in [0, 1]: how far what veils one view alone is looked for
  int32_t threads;
};

// A picture laid over part of another: `over` [height, width, 3] by share x confidence [height, width].
struct CagsLayInput {
  const float *over, *share, *confidence;
  int64_t share_pitch, shown_pitch;  // floats from row to row of `share` and of what is shown
  int32_t width, height, threads;
};

struct CagsCarryInput {
  const float *reference, *then, *now;  // [height, width, 3]: the reference, and the client's own views of it
  int32_t width, height, radius;        // of the pictures; of the local powers
  float caution, plausible, visible;    // see cags_client.carry: CAUTION, PLAUSIBLE / age, VISIBLE_POWER
  int32_t threads;
};

CAGS_API int32_t cags_align(const CagsAlignInput* input, const CagsAlignOutput* output);
// The closed form's factors and offsets [reference_height, reference_width, 4]; what is of the client's view is not read.
CAGS_API int32_t cags_fields(const CagsCorrectInput* input, float* fields);
CAGS_API int32_t cags_lay(const CagsLayInput* input, float* shown);  // shown += weight (over - shown)
CAGS_API int32_t cags_carry(const CagsCarryInput* input, float* carried);  // [height, width, 3] in [0, 1]
CAGS_API int32_t cags_correct(const CagsCorrectInput* input, float* restored);  // [height, width, 3] in [0, 1]
