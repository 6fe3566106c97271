// Masks of a bit a pixel.
#pragma once
#include <cstdint>
#include <cstring>

namespace cags::align {
namespace {  // compiled for several instruction sets

constexpr int kWord = 64;  // pixels of a row that one word has a bit for

// `count` <= 64 bytes of 0 or 1 as bits.
inline uint64_t word_of(const uint8_t* bytes, int count) {
  uint64_t word = 0;
  int i = 0;
  for (; i + 8 <= count; i += 8) {
    uint64_t eight;
    std::memcpy(&eight, bytes + i, sizeof eight);
    word |= (eight * 0x0102040810204080u >> 56) << i;
  }
  for (; i < count; i++) word |= uint64_t{bytes[i]} << i;
  return word;
}

}  // namespace
}  // namespace cags::align
