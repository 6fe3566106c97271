#include "cags_kernels.h"
#include "support/instruction_set.h"

#include <cstring>
#include <initializer_list>

int32_t cags_abi_version() { return 19; }

const char* cags_instruction_set() { return cags::name_of(cags::active_instruction_set()); }

int32_t cags_use_instruction_set(const char* name) {
  for (cags::InstructionSet set : {cags::InstructionSet::portable, cags::InstructionSet::avx2, cags::InstructionSet::avx512}) {
    if (std::strcmp(name, cags::name_of(set)) == 0) return cags::activate(set) ? CAGS_OK : CAGS_INVALID;
  }
  return CAGS_INVALID;
}
