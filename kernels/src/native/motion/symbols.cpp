#include "motion/symbols.h"

#include <algorithm>

namespace cags::motion {

// Bits of the tables, the lowest of each byte first. Beyond the end there are ones, which no number ends in.
struct TableBits {
  const uint8_t *data, *end;
  int64_t at = 0;

  bool next() {
    const uint8_t* byte = data + (at >> 3);
    const bool bit = byte >= end || (*byte >> (at & 7) & 1);
    at++;
    return bit;
  }
  int number(int count) {
    int out = 0;
    for (int bit = 0; bit < count; bit++) out |= int{next()} << bit;
    return out;
  }
  // Ones before the next zero; one more than `most` where there are more.
  int run(int most) {
    int length = 0;
    while (length <= most && next()) length++;
    return length;
  }
  const uint8_t* rest() const { return data + (at + 7) / 8; }
};

namespace {
constexpr int kHalvings = 12, kFinest = 4, kMaxRice = 3;  // cags_common.coding.tables
constexpr uint64_t kMantissas[kFinest] = {16384, 19484, 23170, 27554};
}  // namespace

bool SymbolDecoder::read_table(TableBits& bits, int form, int table) {
  const int log_steps = form & 3, rice = form >> 2, most = 1 + (kHalvings << log_steps);
  const int used = bits.number(8);
  if (!used) {  // as the one before
    if (!table) return false;
    std::copy_n(entries[table - 1], kSymbols, entries[table]);
    std::copy_n(symbols[table - 1], kTotal, symbols[table]);
    return true;
  }
  uint64_t worth[kSymbols], sum = 0;
  int weight = most, occurring = 0, largest = 0;
  for (int symbol = 0; symbol < used; symbol++) {
    const int length = bits.run(2 * most);
    if (length > 2 * most) return false;
    const int folded = length << rice | bits.number(rice);
    weight += folded & 1 ? -(folded + 1 >> 1) : folded >> 1;
    if (weight < 0 || weight > most) return false;
    const int rank = (weight - 1) << (2 - log_steps);
    worth[symbol] = weight ? kMantissas[rank % kFinest] << rank / kFinest : 0;
    occurring += weight > 0;
    sum += worth[symbol];
    if (worth[symbol] > worth[largest]) largest = symbol;
  }
  if (!sum) return false;
  uint32_t left = kTotal;
  std::fill_n(entries[table], kSymbols, Entry{0, 0});
  for (int symbol = 0; symbol < used; symbol++) {
    const uint64_t share = worth[symbol] ? 1 + worth[symbol] * uint64_t(kTotal - occurring) / sum : 0;
    entries[table][symbol].frequency = static_cast<uint16_t>(share);
    left -= static_cast<uint32_t>(share);
  }
  entries[table][largest].frequency = static_cast<uint16_t>(entries[table][largest].frequency + left);
  uint32_t first = 0;
  for (int symbol = 0; symbol < used; symbol++) {
    Entry& entry = entries[table][symbol];
    entry.first = static_cast<uint16_t>(first);
    std::memset(symbols[table] + first, symbol, entry.frequency);
    first += entry.frequency;
  }
  return true;
}

int32_t SymbolDecoder::open(const uint8_t* data, int64_t bytes) {
  constexpr int kHead = 6;
  if (bytes < kHead) return CAGS_SYMBOLS_DAMAGED;
  const uint8_t* const end = data + bytes;
  lanes = data[0], tables = data[1], at = 0;
  uint32_t claimed;
  std::memcpy(&claimed, data + 2, sizeof claimed);
  count = claimed;
  if (lanes < 1 || lanes > kMaxLanes || tables < 1 || tables > kMaxTables) return CAGS_SYMBOLS_DAMAGED;
  data += kHead;
  TableBits bits{data, end};
  const int form = bits.number(8);
  if ((form & 3) == 3 || form >> 2 > kMaxRice) return CAGS_SYMBOLS_DAMAGED;
  for (int table = 0; table < tables; table++) {
    if (!read_table(bits, form, table)) return CAGS_SYMBOLS_DAMAGED;
  }
  data = bits.rest();
  if (data > end || end - data != 4 * int64_t{lanes} + 2 * count) return CAGS_SYMBOLS_DAMAGED;
  std::memcpy(states, data, 4 * size_t(lanes));
  words = data + 4 * lanes;
  return CAGS_OK;
}

bool SymbolDecoder::take(int64_t taken, const uint8_t* __restrict which, uint8_t* __restrict out) {
  for (int64_t row = 0; row < taken; row += lanes) {
    const int width = static_cast<int>(std::min<int64_t>(lanes, taken - row));
    if (count - at < width) return take_last(taken - row, which + row, out + row);
    int64_t next = at;
    for (int lane = 0; lane < width; lane++) {
      uint32_t state = states[lane];
      out[row + lane] = step(state, which[row + lane]);
      const uint32_t low = state < kLow;  // no branch: it could not be foretold
      states[lane] = state << (low << 4) | (word(next) & (0 - low));
      next += low;
    }
    at = next;
  }
  return true;
}

// The same where each word has to be asked for.
bool SymbolDecoder::take_last(int64_t taken, const uint8_t* which, uint8_t* out) {
  int lane = 0;
  for (int64_t i = 0; i < taken; i++) {
    out[i] = step(states[lane], which[i]);
    if (states[lane] < kLow) {
      if (at == count) return false;
      states[lane] = states[lane] << 16 | word(at++);
    }
    lane = lane + 1 == lanes ? 0 : lane + 1;
  }
  return true;
}

bool SymbolDecoder::finished() const {
  return at == count && std::all_of(states, states + lanes, [](uint32_t state) { return state == kLow; });
}

namespace {

struct Coded {
  double inverse;
  uint32_t frequency, first;
};

// Backwards, so that the words come out in the order that they are read in.
int64_t encode(int64_t count, const uint8_t* tables, const uint8_t* symbols, int64_t runs, const int64_t* run_lengths, int lanes,
               const Coded* coded, uint32_t* states, uint16_t* words) {
  std::fill_n(states, lanes, kLow);
  int64_t end = count, word = count;
  for (int64_t run = runs - 1; run >= 0; end -= run_lengths[run--]) {
    const int64_t first = end - run_lengths[run];
    int lane = static_cast<int>((end - 1 - first) % lanes);
    for (int64_t i = end - 1; i >= first; i--) {
      const Coded& c = coded[tables[i] * kSymbols + symbols[i]];
      uint32_t state = states[lane];
      const bool full = state >= uint64_t{c.frequency} << (32 - kProbabilityBits);
      if (full) words[--word] = static_cast<uint16_t>(state), state >>= 16;
      // The half keeps the product of rounded numbers from falling below a whole quotient.
      const uint32_t quotient = static_cast<uint32_t>(static_cast<int64_t>((state + 0.5) * c.inverse));
      states[lane] = (quotient << kProbabilityBits) + (state - quotient * c.frequency) + c.first;
      lane = lane == 0 ? lanes - 1 : lane - 1;
    }
  }
  return count - word;
}

}  // namespace
}  // namespace cags::motion

using namespace cags::motion;

int32_t cags_symbols_count(const uint8_t* tables, int64_t tables_length, const uint8_t* symbols, int64_t symbols_length,
                           int64_t* counts, int64_t counts_length) {
  if (tables_length != symbols_length || counts_length != kMaxTables * kSymbols) return CAGS_INVALID;
  std::fill_n(counts, counts_length, int64_t{0});
  for (int64_t i = 0; i < tables_length; i++) {
    if (tables[i] >= kMaxTables) return CAGS_INVALID;
    counts[tables[i] * kSymbols + symbols[i]]++;
  }
  return CAGS_OK;
}

int32_t cags_symbols_encode(const CagsSymbolsEncoding* given, int64_t* word_count) {
  const auto [tables, symbols, run_lengths, frequencies, firsts, states, words, lengths] = *given;
  const int64_t count = lengths[0], runs = lengths[2], lanes = lengths[5];
  if (count < 0 || lengths[1] != count || lengths[6] != count || runs < 0 || lanes < 1 || lanes > kMaxLanes) return CAGS_INVALID;
  int64_t sum = 0;
  for (int64_t run = 0; run < runs; run++) {
    if (run_lengths[run] < 0 || run_lengths[run] > count - sum) return CAGS_INVALID;
    sum += run_lengths[run];
  }
  int used = 0;
  for (int64_t i = 0; i < count; i++) used = std::max<int>(used, tables[i] + 1);
  if (sum != count || used > kMaxTables || std::min(lengths[3], lengths[4]) < used * kSymbols) return CAGS_INVALID;
  static thread_local Coded coded[kMaxTables * kSymbols];
  for (int i = 0; i < used * kSymbols; i++) {
    if (frequencies[i] > kTotal || firsts[i] > kTotal) return CAGS_INVALID;
    coded[i] = {1.0 / std::max(frequencies[i], 1u), std::max(frequencies[i], 1u), firsts[i]};
  }
  *word_count = encode(count, tables, symbols, runs, run_lengths, static_cast<int>(lanes), coded, states, words);
  return CAGS_OK;
}

int64_t cags_symbols_decoder_bytes() { return sizeof(SymbolDecoder); }

int32_t cags_symbols_open(const uint8_t* data, int64_t bytes, void* decoder, int64_t decoder_bytes) {
  if (decoder_bytes != cags_symbols_decoder_bytes()) return CAGS_INVALID;
  return static_cast<SymbolDecoder*>(decoder)->open(data, bytes);
}

int32_t cags_symbols_take(void* decoder, const uint8_t* tables, int64_t tables_length, uint8_t* symbols, int64_t symbols_length) {
  auto& self = *static_cast<SymbolDecoder*>(decoder);
  if (tables_length < 0 || symbols_length != tables_length) return CAGS_INVALID;
  for (int64_t i = 0; i < tables_length; i++) {
    if (tables[i] >= self.tables) return CAGS_SYMBOLS_TABLE;
  }
  return self.take(tables_length, tables, symbols) ? int32_t{CAGS_OK} : int32_t{CAGS_SYMBOLS_END};
}

int32_t cags_symbols_finish(const void* decoder) {
  return static_cast<const SymbolDecoder*>(decoder)->finished() ? int32_t{CAGS_OK} : int32_t{CAGS_SYMBOLS_LEFT};
}
