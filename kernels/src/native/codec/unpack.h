// Bits to codes, eight at a time: eight codes of b bits are b bytes.
#pragma once
#include <cstdint>
#include <cstring>

namespace cags::codec {

inline constexpr int kGroup = 8;

// codes[i] = codes[i] << Bits | the i-th code of `data`, for i in [0, count); reads ceil(count Bits / 8) bytes.
template <int Bits>
void append(const uint8_t* data, int count, uint32_t* codes) {
  constexpr uint64_t mask = (1u << Bits) - 1;
  int i = 0;
  for (; i + kGroup <= count; i += kGroup, data += Bits) {
    uint64_t word = 0;
    std::memcpy(&word, data, Bits);
    for (int j = 0; j < kGroup; j++) codes[i + j] = codes[i + j] << Bits | static_cast<uint32_t>(word >> (Bits * j) & mask);
  }
  if (i == count) return;
  uint64_t word = 0;
  std::memcpy(&word, data, static_cast<size_t>((count - i) * Bits + 7) / 8);
  for (int j = 0; i + j < count; j++) codes[i + j] = codes[i + j] << Bits | static_cast<uint32_t>(word >> (Bits * j) & mask);
}

using Append = void (*)(const uint8_t* data, int count, uint32_t* codes);

inline constexpr int kMostBits = 8;
inline constexpr Append kAppend[kMostBits + 1] = {nullptr,   append<1>, append<2>, append<3>, append<4>,
                                                  append<5>, append<6>, append<7>, append<8>};

}  // namespace cags::codec
