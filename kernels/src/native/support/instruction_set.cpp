#include "support/instruction_set.h"

#include <atomic>

namespace cags {
namespace {

InstructionSet best() {
  if (runs_here(InstructionSet::avx512)) return InstructionSet::avx512;
  if (runs_here(InstructionSet::avx2)) return InstructionSet::avx2;
  return InstructionSet::portable;
}

std::atomic<InstructionSet>& active() {
  static std::atomic<InstructionSet> set{best()};
  return set;
}

}  // namespace

const char* name_of(InstructionSet set) {
  switch (set) {
    case InstructionSet::avx512: return "avx512";
    case InstructionSet::avx2: return "avx2";
    default: return "portable";
  }
}

bool runs_here([[maybe_unused]] InstructionSet set) {
#ifdef CAGS_X86
  if (set == InstructionSet::avx512)
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("bmi2");
  if (set == InstructionSet::avx2)
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
           __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("popcnt");
#endif
  return set == InstructionSet::portable;
}

InstructionSet active_instruction_set() { return active().load(std::memory_order_relaxed); }

bool activate(InstructionSet set) {
  if (!runs_here(set)) return false;
  active().store(set, std::memory_order_relaxed);
  return true;
}

}  // namespace cags
