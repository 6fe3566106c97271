// Stage 3: a tile's splats front to back. Equal depths are ordered by the splats' content, so that the picture does not
// depend on the order in which a scene lists its splats.
#pragma once
#include "raster/layout.h"

#include <cstring>

namespace cags::raster {
namespace {

constexpr int kInsertionLimit = 24;
constexpr int kLeadingBits = 16;  // of the depths' range: two passes tell nearly all entries of a tile apart

// Stable least-significant-digit radix sort of `n` entries by bits [shift, shift + bits). Returns the sorted array: one of
// the two given; the other is spoilt.
inline uint64_t* radix_sort(uint64_t* from, uint64_t* to, int n, uint64_t least, int shift, int bits) {
  for (int low = shift; low < shift + bits; low += 8) {
    uint32_t begin[256];
    std::memset(begin, 0, sizeof begin);
    for (int i = 0; i < n; i++) begin[((from[i] - least) >> low) & 255]++;
    uint32_t sum = 0;
    for (uint32_t& b : begin) {
      const uint32_t count = b;
      b = sum, sum += count;
    }
    for (int i = 0; i < n; i++) to[begin[((from[i] - least) >> low) & 255]++] = from[i];
    uint64_t* swapped = from;
    from = to, to = swapped;
  }
  return from;
}

inline bool before(uint64_t a, uint64_t b, const Record* records) {
  if (a >> 32 != b >> 32) return a < b;
  return records[uint32_t(a)].tie < records[uint32_t(b)].tie;
}

inline void insertion_sort(uint64_t* entries, int n, const Record* records) {
  for (int i = 1; i < n; i++) {
    const uint64_t entry = entries[i];
    int j = i;
    for (; j > 0 && before(entry, entries[j - 1], records); j--) entries[j] = entries[j - 1];
    entries[j] = entry;
  }
}

struct DepthRange {
  uint64_t least;  // the least depth's bits << 32
  int bits;        // that the depths differ in
};

inline DepthRange depth_range(const uint64_t* entries, int n) {
  uint64_t least = ~uint64_t{0}, most = 0;
  for (int i = 0; i < n; i++) {
    least = entries[i] < least ? entries[i] : least;
    most = entries[i] > most ? entries[i] : most;
  }
  least = least >> 32 << 32;
  const uint32_t range = uint32_t((most - least) >> 32);
  return {least, range ? 32 - __builtin_clz(range) : 0};
}

// Calls body(begin, end) for each run of more than one entry that are equal in (entry - least) >> low.
template <typename Body>
inline void for_runs(const uint64_t* entries, int n, uint64_t least, int low, const Body& body) {
  for (int begin = 0, end; begin + 1 < n; begin = end) {
    const uint64_t first = (entries[begin] - least) >> low;
    for (end = begin + 1; end < n && (entries[end] - least) >> low == first;) end++;
    if (end - begin > 1) body(begin, end);
  }
}

// Orders a run of equal depths by content, in place.
inline void order_ties(uint64_t* run, uint64_t* spare, int n, const Record* records) {
  if (n <= kInsertionLimit) return insertion_sort(run, n, records);
  const uint64_t depth = run[0] >> 32 << 32;
  for (int i = 0; i < n; i++) run[i] = uint64_t(records[uint32_t(run[i])].tie) << 32 | uint32_t(run[i]);
  const uint64_t* sorted = radix_sort(run, spare, n, 0, 32, 32);  // an even number of passes: in place
  for (int i = 0; i < n; i++) run[i] = depth | uint32_t(sorted[i]);
}

// Orders a run of nearly equal depths, in place.
inline void order_run(uint64_t* run, uint64_t* spare, int n, const Record* records) {
  if (n <= kInsertionLimit) return insertion_sort(run, n, records);
  const DepthRange range = depth_range(run, n);
  const uint64_t* sorted = radix_sort(run, spare, n, range.least, 32, range.bits);
  if (sorted != run) std::memcpy(run, sorted, n * sizeof *run);
  for_runs(run, n, range.least, 32, [&](int begin, int end) { order_ties(run + begin, spare, end - begin, records); });
}

// Sorts entries (depth bits << 32 | record) by depth, then content. Returns the sorted array: `entries` or `spare`.
inline uint64_t* order(uint64_t* entries, uint64_t* spare, int n, const Record* records) {
  if (n <= kInsertionLimit) {
    insertion_sort(entries, n, records);
    return entries;
  }
  const DepthRange range = depth_range(entries, n);
  const int leading = range.bits < kLeadingBits ? range.bits : kLeadingBits, low = 32 + range.bits - leading;
  uint64_t* sorted = radix_sort(entries, spare, n, range.least, low, leading);
  uint64_t* other = sorted == entries ? spare : entries;
  for_runs(sorted, n, range.least, low, [&](int begin, int end) { order_run(sorted + begin, other, end - begin, records); });
  return sorted;
}

}  // namespace
}  // namespace cags::raster
