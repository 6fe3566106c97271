// Compiled once for each instruction set; CAGS_CORRECT_STAGES names the variant's table.
#include "correct/stages.h"
#include "correct/stages/add.h"
#include "correct/stages/compare.h"
#include "correct/stages/expand.h"
#include "correct/stages/occlude.h"

namespace cags::correct {

extern const Stages CAGS_CORRECT_STAGES{expand, apart, compare, survey, patch, finish, surround};

}  // namespace cags::correct
