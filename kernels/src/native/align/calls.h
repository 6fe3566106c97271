// What every call of the C interface needs: its stages, its memory, and its threads' shares of rows.
#pragma once
#include "align/stages.h"
#include "support/aligned.h"
#include "support/calls.h"
#include "support/instruction_set.h"
#include "support/thread_pool.h"

#include <algorithm>

namespace cags::align {

constexpr int kRowsAPiece = 16;

inline const Stages& stages() { return in_use(CAGS_VARIANTS(stages)); }

struct Scratch {
  AlignedArray<float> nearest_depth, reference, sums, parts, fields, lines, disagreement, weight, means;
  AlignedArray<uint8_t> shared;
  AlignedArray<uint64_t> bits;
  AlignedArray<Nearest> nearest;
};

using ScratchLease = Lease<Scratch>;

template <typename Body>
void for_rows(int threads, int rows, const Body& body) {
  parallel_for(threads, (rows + kRowsAPiece - 1) / kRowsAPiece, [&](int piece, int worker) {
    const int end = std::min(rows, (piece + 1) * kRowsAPiece);
    for (int row = piece * kRowsAPiece; row < end; row++) body(row, worker);
  });
}

}  // namespace cags::align
