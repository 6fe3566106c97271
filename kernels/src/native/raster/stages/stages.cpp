// The hot stages, compiled once for each instruction set; CAGS_STAGES names the variant's table.
#include "raster/stages.h"
#include "raster/stages/peak.h"
#include "raster/stages/project.h"
#include "raster/stages/tile.h"
#include "raster/stages/enlarge.h"

namespace cags::raster {

extern const Stages CAGS_STAGES{project, scatter, composite, enlarge, multiply_adds, sizeof(TileWork)};

}  // namespace cags::raster
