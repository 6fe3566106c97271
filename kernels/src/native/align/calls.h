// What every call of the C interface needs: its memory, its threads' shares of rows, and its status.
#pragma once
#include "align/stages.h"
#include "cags_kernels.h"
#include "support/aligned.h"
#include "support/instruction_set.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <memory>
#include <mutex>
#include <new>
#include <vector>

namespace cags::align {

constexpr int kRowsAPiece = 16;

inline const Stages& stages() {
  switch (active_instruction_set()) {
#ifdef CAGS_X86
    case InstructionSet::avx512: return stages_avx512;
    case InstructionSet::avx2: return stages_avx2;
#endif
    default: return stages_portable;
  }
}

// Memory of one call, kept for the next one: fresh pages cost more than the work on them.
struct Scratch {
  AlignedArray<float> nearest_depth, reference, sums, fields, lines, disagreement, weight, means;
  AlignedArray<uint8_t> shared;
  AlignedArray<uint64_t> bits;
  AlignedArray<Nearest> nearest;
};

class ScratchLease {
 public:
  ScratchLease() {
    std::lock_guard lock(mutex());
    if (idle().empty()) {
      scratch_ = std::make_unique<Scratch>();
    } else {
      scratch_ = std::move(idle().back());
      idle().pop_back();
    }
  }
  ~ScratchLease() {
    std::lock_guard lock(mutex());
    idle().push_back(std::move(scratch_));
  }
  ScratchLease(const ScratchLease&) = delete;
  ScratchLease& operator=(const ScratchLease&) = delete;
  Scratch* operator->() const { return scratch_.get(); }
  Scratch& operator*() const { return *scratch_; }

 private:
  static std::mutex& mutex() {
    static std::mutex instance;
    return instance;
  }
  static std::vector<std::unique_ptr<Scratch>>& idle() {
    static auto* instance = new std::vector<std::unique_ptr<Scratch>>;  // never destroyed: see Pool
    return *instance;
  }
  std::unique_ptr<Scratch> scratch_;
};

template <typename Body>
void for_rows(int threads, int rows, const Body& body) {
  parallel_for(threads, (rows + kRowsAPiece - 1) / kRowsAPiece, [&](int piece, int worker) {
    const int end = std::min(rows, (piece + 1) * kRowsAPiece);
    for (int row = piece * kRowsAPiece; row < end; row++) body(row, worker);
  });
}

template <typename Body>
int32_t guarded(const Body& body) {
  try {
    body();
    return CAGS_OK;
  } catch (const std::bad_alloc&) {
    return CAGS_OUT_OF_MEMORY;
  } catch (...) {
    return CAGS_FAILED;
  }
}

}  // namespace cags::align
