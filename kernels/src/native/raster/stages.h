// The stages of a frame, in the variant for one instruction set.
#pragma once
#include "raster/layout.h"

#include <cstddef>

namespace cags::raster {

struct Stages {
  // Projects and culls one chunk, evaluates colours, writes records, counts entries a tile.
  void (*project)(const SceneData&, const View&, const FrameData&, int chunk);
  // Writes the chunk's entries into its tiles' lists.
  void (*scatter)(const View&, const FrameData&, int chunk);
  // Sorts and composites one tile into the targets.
  void (*composite)(const View&, const FrameData&, const Targets&, TileScratch&, int tile);
  // Row y of the whole image; `row` has room for (width + 1) / 2 + 4 pixels of three channels.
  void (*enlarge)(const EnlargeJob&, int y, float* row);
  double (*multiply_adds)(int64_t rounds);
  size_t work_bytes;
};

extern const Stages stages_portable;
#ifdef CAGS_X86
extern const Stages stages_avx2, stages_avx512;
#endif

const Stages& active_stages();  // of the instruction set in use

}  // namespace cags::raster
