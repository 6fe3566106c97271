// Range asymmetric numeral systems: lanes of 32-bit states that share a stream of 16-bit words.
#pragma once
#include "motion/cags_motion.h"

#include <bit>
#include <cstring>

namespace cags::motion {

static_assert(std::endian::native == std::endian::little);

inline constexpr int kProbabilityBits = 12, kTotal = 1 << kProbabilityBits;
inline constexpr int kMaxLanes = 32, kMaxTables = 64, kSymbols = 256;
inline constexpr uint32_t kLow = 1u << 16;

struct TableBits;

struct SymbolDecoder {
  struct Entry {
    uint16_t frequency, first;
  };
  const uint8_t* words;
  int64_t count, at;  // words, and the next one
  int32_t lanes, tables;
  uint32_t states[kMaxLanes];
  Entry entries[kMaxTables][kSymbols];
  uint8_t symbols[kMaxTables][kTotal];  // of each slot; only those of `tables` tables are set

  int32_t open(const uint8_t* data, int64_t bytes);
  // Symbols of `count` tables below `tables` (the caller checks). False when the words end too early.
  bool take(int64_t count, const uint8_t* which, uint8_t* out);
  bool finished() const;

 private:
  bool read_table(TableBits& bits, int form, int table);
  bool take_last(int64_t count, const uint8_t* which, uint8_t* out);

  // One step of a lane; the symbol. Whether it wants a word is for the caller to see: the state is below kLow then.
  uint8_t step(uint32_t& state, uint8_t table) const {
    const uint32_t slot = state & (kTotal - 1);
    const uint8_t symbol = symbols[table][slot];
    const Entry entry = entries[table][symbol];
    state = entry.frequency * (state >> kProbabilityBits) + slot - entry.first;
    return symbol;
  }
  uint32_t word(int64_t index) const {
    uint16_t value;
    std::memcpy(&value, words + 2 * index, sizeof value);
    return value;
  }
};

}  // namespace cags::motion
