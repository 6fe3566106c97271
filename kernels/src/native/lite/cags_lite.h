// The C interface of the network `lite`; see cags_client.restore.networks.lite for what it computes.
#pragma once
#include "cags_kernels.h"

// Weights of convolutions are those of Winograd's domain (see stages/winograd.h): [36, channels in, channels out].
struct CagsLiteInput {
  const float* own;        // [height, width, 3]: the client's splats seen from the reference
  const float* reference;  // [height, width, 3]
  const float* fields;     // [height, width, 4]: factor and offsets of the closed form
  int32_t width, height;   // even
  const float *head, *head_bias;  // [40, 24], [24]: the bias holds the coding noise's part
  const float *body, *body_bias;  // [layers, 36, 24, 24], [layers, 24]
  const float *tail, *tail_bias;  // [36, 24, 16], [16]
  int32_t layers;                 // of the body, even
  float factor_reach, colour_reach;  // bounds of the change to the factor and to the correction, above 0
  int32_t threads;
};

// `improved` [height, width, 4] may be `fields` itself.
CAGS_API int32_t cags_lite(const CagsLiteInput* input, float* improved);
