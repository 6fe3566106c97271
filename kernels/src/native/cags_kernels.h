// The C interface of the native library: plain structures and pointers, no exceptions, no ownership of the caller's arrays.
#pragma once
#include <cstdint>

#define CAGS_API extern "C" __attribute__((visibility("default")))

enum CagsStatus : int32_t { CAGS_OK = 0, CAGS_INVALID = 1, CAGS_OUT_OF_MEMORY = 2, CAGS_FAILED = 3 };
enum CagsExactness : int32_t { CAGS_FAST = 0, CAGS_BALANCED = 1, CAGS_EXACT = 2 };
enum CagsDepth : int32_t { CAGS_DEPTH_NONE = 0, CAGS_DEPTH_EXPECTED = 1 };

// Splats as arrays of rows; every value finite, quaternions of non-zero norm (the caller checks and names what is not).
struct CagsSplats {
  int64_t count;
  int32_t sh_rest_count;         // view-dependent coefficients a channel: 0, 3, 8 or 15
  const float* means;            // [count, 3] world
  const float* quats;            // [count, 4] wxyz
  const float* log_scales;       // [count, 3]
  const float* logit_opacities;  // [count]
  const float* sh0;              // [count, 3]
  const float* sh_rest;          // [count, sh_rest_count, 3]
  int64_t lengths[6];            // floats in each of the six, in their order: what does not fit is refused
};

struct CagsCamera {
  double rotation[9];     // world to camera, row-major
  double position[3];     // of the camera, world
  double fx, fy, cx, cy;  // pixels; pixel centres at + 0.5
  double near_plane;
  int32_t width, height;
};

struct CagsRasterOptions {
  float dilation, filter;  // squared pixels, see Footprint
  float void_alpha;
  float brightest;  // no colour comes out above it
  int32_t exactness, depth, max_sh_degree, threads;
};

// Where a view goes; a null pointer leaves that part out.
struct CagsRasterTargets {
  float* rgb;           // [height, width, 3]
  float* alpha;         // [height, width]
  float* depth;         // [height, width]
  float* contribution;  // [count]
  int64_t lengths[4];   // floats in each of the four, in their order: what does not fit is refused
};

// What the last step of a frame did, for benchmarks.
struct CagsRasterStatistics {
  double project_ms, bin_ms, tiles_ms;
  int64_t visible, entries, block_visits;
};

// Does independent multiply-adds, for benchmarks; returns how many.
CAGS_API double cags_multiply_adds(int64_t rounds);

struct CagsRasterScene;

CAGS_API int32_t cags_abi_version();

// A field of a structure of this interface, as the library was compiled; of a structure as a whole where `field` is empty.
struct CagsField {
  const char *structure, *field;
  int64_t offset, bytes;
};
CAGS_API const CagsField* cags_layout(int64_t* count);  // a caller whose own structures differ must not call anything else

CAGS_API const char* cags_instruction_set();
CAGS_API int32_t cags_use_instruction_set(const char* name);  // for tests and benchmarks; CAGS_INVALID when not runnable here

CAGS_API int32_t cags_raster_scene_create(const CagsSplats* splats, int32_t threads, CagsRasterScene** scene);
CAGS_API void cags_raster_scene_destroy(CagsRasterScene* scene);
// `all` has a splat for each of the scene's, of which those at rising `rows` changed: all of them, or position, rotation and
// opacity alone, are taken from there. Nothing is changed where one of them cannot be drawn (CAGS_INVALID).
CAGS_API int32_t cags_raster_scene_update(CagsRasterScene* scene, const int64_t* rows, int64_t count, const CagsSplats* all,
                                          int32_t threads);
CAGS_API int32_t cags_raster_scene_move(CagsRasterScene* scene, const int64_t* rows, int64_t count, const CagsSplats* all,
                                        int32_t threads);
CAGS_API int32_t cags_raster_render(CagsRasterScene* scene, const CagsCamera* camera, const CagsRasterOptions* options,
                                    const CagsRasterTargets* targets, CagsRasterStatistics* statistics);

// Brings a picture [(height + 1) / 2, (width + 1) / 2, 3] up to `whole` [height, width, 3], both in [0, 1].
// Lengths are in floats.
CAGS_API int32_t cags_enlarge(const float* half, int64_t half_length, int32_t width, int32_t height, int32_t threads,
                              float* whole, int64_t whole_length);
