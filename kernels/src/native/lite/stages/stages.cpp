// Compiled once for each instruction set; CAGS_LITE_STAGES names the variant's table.
#include "lite/stages.h"
#include "lite/stages/layers.h"

namespace cags::lite {

extern const Stages CAGS_LITE_STAGES{head, convolve, tail};

}  // namespace cags::lite
