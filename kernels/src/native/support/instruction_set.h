// Which of the compiled variants of the hot code this processor runs.
#pragma once

namespace cags {

enum class InstructionSet { portable, avx2, avx512 };

const char* name_of(InstructionSet set);
bool runs_here(InstructionSet set);

// The best one that runs here, unless another was activated. Kernels ask at the start of each call.
InstructionSet active_instruction_set();
bool activate(InstructionSet set);  // false, and nothing changes, when it does not run here

}  // namespace cags
