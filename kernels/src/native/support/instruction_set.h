// Which of the compiled variants of the hot code this processor runs.
#pragma once

namespace cags {

enum class InstructionSet { portable, avx2, avx512 };

const char* name_of(InstructionSet set);
bool runs_here(InstructionSet set);

// The best one that runs here, unless another was activated. Kernels ask at the start of each call.
InstructionSet active_instruction_set();
bool activate(InstructionSet set);  // false, and nothing changes, when it does not run here

// Of something that is compiled once for each, the one in use: `in_use(CAGS_VARIANTS(stages))`.
template <typename T>
const T& in_use(const T& portable) {
  return portable;
}

template <typename T>
const T& in_use(const T& portable, const T& avx2, const T& avx512) {
  switch (active_instruction_set()) {
    case InstructionSet::avx512: return avx512;
    case InstructionSet::avx2: return avx2;
    default: return portable;
  }
}

#ifdef CAGS_X86
#define CAGS_VARIANTS(name) name##_portable, name##_avx2, name##_avx512
#else
#define CAGS_VARIANTS(name) name##_portable
#endif

}  // namespace cags
