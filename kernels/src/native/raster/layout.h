// The data that the stages of a frame share. Plain structures: the hot code that reads them is compiled several times, and
// must not instantiate library templates that the linker could then pick for a processor that cannot run them.
#pragma once
#include <cstdint>

namespace cags::raster {

inline constexpr int kTile = 32;  // pixels a side; splats are binned and sorted by tile
inline constexpr int kBlock = 4;  // pixels a side; a block's pixels stay in registers while it is blended
inline constexpr int kBlocksPerSide = kTile / kBlock;
inline constexpr int kBlocks = kBlocksPerSide * kBlocksPerSide;
inline constexpr int kBlockPixels = kBlock * kBlock;
inline constexpr int kBatch = 256;  // splats of a tile that are covered and blended together
inline constexpr int kWordBits = 64;
inline constexpr int kLanes = 16;  // splats a block of the scene's arrays, whatever the vector width

inline constexpr float kAlphaMax = 0.99f;             // Kerbl et al. 2023
inline constexpr float kLog2AlphaCut = -7.99435344f;  // log2(1 / 255): a weaker pixel is not drawn
inline constexpr float kJacobianMargin = 1.3f;        // of tan(FoV / 2): where the projection's linearisation is held
inline constexpr float kHalfLog2E = 0.72134752f;      // exp(-q / 2) = exp2(-kHalfLog2E q)
inline constexpr float kMaxDepth = 1e12f;             // nothing is drawn beyond
inline constexpr double kMaxScale = 1e7;              // standard deviations are clamped to it

// One scene, as the stages read it: arrays of `padded` splats (a multiple of kLanes), padded with invisible ones.
struct SceneData {
  int count, padded, sh_rest;
  const float* mean[3];
  const float* axes[9];  // row-major rotation x scale: columns are the Gaussian's scaled axes in the world
  const float* log2_opacity;
  const float* base[3];   // 0.5 + SH_C0 sh0
  const uint32_t* tie;    // hash of the splat's content: decides between equal depths
  const float* rest;      // [padded / kLanes][sh_rest * 3][kLanes]
  const uint8_t* degree;  // [padded / kLanes] highest SH degree with a coefficient other than zero
};

// Camera and options in the form that the stages use.
struct View {
  double rotation[9], position[3], fx, fy, cx, cy;  // world to camera; cx, cy less half a pixel: pixel i is at i
  float near_plane, limit_x, limit_y;               // limits of x / z and y / z in the Jacobian
  float dilation, variance;                         // squared pixels added before and after the filter
  int width, height, tiles_x, tiles_y;
  int sh_degree, exactness, depth;
  float brightest;         // no colour comes out above it
  float void_alpha, stop;  // a block is finished when no pixel transmits more than `stop`
};

// A splat that touches the image: one cache line. A pixel's alpha is exp2(log2_opacity - s^2 - t^2) with
// s = l11 dx + l12 dy, t = l22 dy: the Cholesky factor of the inverse covariance, which unlike the inverse itself loses
// nothing on needles. The centre is kept in two parts, so that it stays exact relative to any tile.
struct alignas(64) Record {
  float u, v, u_rest, v_rest;  // pixels
  float l11, l12, l22, log2_opacity;
  float r, g, b, z;
  uint16_t tile_x0, tile_x1, tile_y0, tile_y1;  // inclusive
  uint32_t tie;
  uint32_t slot;  // first of its tile entries, counted from the start of its chunk
};
static_assert(sizeof(Record) == 64);

struct alignas(64) Colours {
  float rgb[3][kLanes];
};

// A frame's working memory. Splats are projected in chunks; a chunk's records start at chunk * chunk_size.
struct FrameData {
  int chunks, chunk_size;
  Record* records;         // [chunks * chunk_size]
  int32_t* splat;          // [chunks * chunk_size] which splat a record is
  int32_t* chunk_records;  // [chunks]
  uint32_t* tile_cursor;   // [chunks][tiles] number of entries, later where the chunk's next one goes
  uint32_t* tile_start;    // [tiles + 1]
  uint32_t* chunk_slot;    // [chunks + 1] first slot of each chunk
  uint64_t* entries;       // [tile_start[tiles]] depth bits << 32 | record
  float* slots;            // [tile_start[tiles]] what each entry contributed to its pixels; null: nobody asks
};

// Where pixels go; null: nobody asks.
struct Targets {
  float *rgb, *alpha, *depth;
};

// A picture of half the pixels a side, and where the whole one goes, whose size is `width` x `height`.
struct EnlargeJob {
  const float* half;
  float* whole;
  int width, height;
};

// Per-thread memory of the tile stage.
struct TileScratch {
  uint64_t* spare;  // as many entries as the fullest tile
  void* work;       // TileWork of the variant
  int64_t block_visits;
};

}  // namespace cags::raster
