// Compiled once for each instruction set; CAGS_ALIGN_STAGES names the variant's table.
#include "align/stages.h"
#include "align/stages/carry.h"
#include "align/stages/correct.h"
#include "align/stages/fit.h"
#include "align/stages/lay.h"
#include "align/stages/resolve.h"

namespace cags::align {

extern const Stages CAGS_ALIGN_STAGES{nearest, resolve, clean, fit, trust, take, compare, settle, carry_powers, carry_means, carry, lay, correct};

}  // namespace cags::align
