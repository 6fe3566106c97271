// Stage 3: a tile's splats front to back. Equal depths are ordered by the splats' content, so that the picture does not
// depend on the order in which a scene lists its splats.
#pragma once
#include "raster/layout.h"

#include <cstring>

namespace cags::raster {
namespace {

constexpr int kInsertionLimit = 24;

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

// Orders a run of equal depths by content.
inline void order_ties(uint64_t* run, uint64_t* spare, int n, const Record* records) {
  if (n <= kInsertionLimit) return insertion_sort(run, n, records);
  const uint64_t depth = run[0] >> 32 << 32;
  for (int i = 0; i < n; i++) run[i] = uint64_t(records[uint32_t(run[i])].tie) << 32 | uint32_t(run[i]);
  const uint64_t* sorted = radix_sort(run, spare, n, 0, 32, 32);  // an even number of passes: in place
  for (int i = 0; i < n; i++) run[i] = depth | uint32_t(sorted[i]);
}

// Sorts entries (depth bits << 32 | record) by depth, then content. Returns the sorted array: `entries` or `spare`.
inline uint64_t* order(uint64_t* entries, uint64_t* spare, int n, const Record* records) {
  if (n <= kInsertionLimit) {
    insertion_sort(entries, n, records);
    return entries;
  }
  uint64_t least = ~uint64_t{0}, most = 0;
  for (int i = 0; i < n; i++) {
    least = entries[i] < least ? entries[i] : least;
    most = entries[i] > most ? entries[i] : most;
  }
  least = least >> 32 << 32;
  const uint32_t range = uint32_t((most - least) >> 32);
  const int bits = range ? 32 - __builtin_clz(range) : 0;
  uint64_t* sorted = radix_sort(entries, spare, n, least, 32, bits);
  uint64_t* other = sorted == entries ? spare : entries;
  for (int begin = 0; begin + 1 < n;) {
    int end = begin + 1;
    while (end < n && sorted[end] >> 32 == sorted[begin] >> 32) end++;
    if (end - begin > 1) order_ties(sorted + begin, other, end - begin, records);
    begin = end;
  }
  return sorted;
}

}  // namespace
}  // namespace cags::raster
