// Codes by context: what a splat's neighbours along the Morton order have makes its own codes likely. The readable
// definition is cags_common.tiles.contexts; both give the same bytes.
#include "codec/cags_codec.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <limits>
#include <vector>

namespace cags::codec {
namespace {

constexpr int kProbabilityBits = 12, kTotal = 1 << kProbabilityBits;
constexpr int kMaxLanes = 32, kMostBits = 4, kMostPrefixBits = 8;
constexpr uint32_t kLow = 1u << 16;
constexpr int64_t kMostSplats = std::numeric_limits<int32_t>::max() / 8;

// Indices 0, then the odd multiples of the largest power of two below `count`, of half of it, and so on: each comes
// after those that lie as far before and behind it. `body` gets the first one of a run, their distance and their number.
template <typename Body>
bool for_runs(int64_t count, const Body& body) {
  if (count > 0 && !body(int64_t{0}, int64_t{1}, int64_t{1})) return false;
  if (count < 2) return true;
  for (int64_t step = int64_t(std::bit_floor(uint64_t(count - 1))); step; step /= 2) {
    if (!body(step, 2 * step, (count - 1 - step) / (2 * step) + 1)) return false;
  }
  return true;
}

void find_nearest(const float* cells, int64_t count, int32_t* nearest) {
  nearest[0] = nearest[1] = -1;
  for (int64_t i = 1; i < count; i++) {
    const int64_t step = i & -i;
    double least[2] = {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
    int32_t* found = nearest + 2 * i;
    found[0] = found[1] = -1;
    for (const int64_t at : {i - step, i + step, i - 3 * step, i + 3 * step}) {
      if (at < 0 || at >= count) continue;
      double square = 0;
      for (int axis = 0; axis < 3; axis++) {
        const double away = double{cells[3 * at + axis]} - double{cells[3 * i + axis]};
        square += away * away;
      }
      if (square < least[0]) {
        least[1] = least[0], found[1] = found[0];
        least[0] = square, found[0] = static_cast<int32_t>(at);
      } else if (square < least[1]) {
        least[1] = square, found[1] = static_cast<int32_t>(at);
      }
    }
  }
}

int contexts_of(const CagsCodecSymbols& model) {
  return model.prefix_bits ? (1 + (2 << model.bits)) << model.prefix_bits : 2 << model.bits;
}

bool valid(const CagsCodecSymbols& model, int64_t count) {
  if (model.bits < 1 || model.bits > kMostBits || model.prefix_bits < 0 || model.prefix_bits > kMostPrefixBits) return false;
  if (count < 0 || count > kMostSplats || model.lengths[1] != 2 * count) return false;
  if (model.lengths[0] != (model.prefix_bits ? count : 0)) return false;
  const int symbols = 1 << model.bits, contexts = contexts_of(model);
  if (model.lengths[2] != int64_t{contexts} * symbols) return false;
  for (int context = 0; context < contexts; context++) {
    int sum = 0;
    for (int symbol = 0; symbol < symbols; symbol++) {
      const int frequency = model.frequencies[context * symbols + symbol];
      if (!frequency) return false;
      sum += frequency;
    }
    if (sum != kTotal) return false;
  }
  for (int64_t i = 0; i < 2 * count; i++) {
    if (model.nearest[i] < -1 || model.nearest[i] >= count) return false;
  }
  for (int64_t i = 0; i < model.lengths[0]; i++) {
    if (model.prefixes[i] >> model.prefix_bits) return false;
  }
  return true;
}

int context_of(const CagsCodecSymbols& model, const uint8_t* codes, int64_t i) {
  const int32_t near = model.nearest[2 * i], next = model.nearest[2 * i + 1];
  if (!model.prefix_bits) return near < 0 ? 0 : 2 * codes[near] + (next >= 0 && codes[next] == codes[near]);
  const int prefix = model.prefixes[i], symbols = 1 << model.bits;
  int state = 0;
  if (near >= 0 && model.prefixes[near] == prefix) {
    state = 1 + codes[near];
  } else if (next >= 0 && model.prefixes[next] == prefix) {
    state = 1 + symbols + codes[next];
  }
  return prefix * (1 + 2 * symbols) + state;
}

struct Entry {
  uint16_t frequency, first;
};

std::vector<Entry> entries_of(const CagsCodecSymbols& model) {
  std::vector<Entry> entries(size_t(model.lengths[2]));
  const size_t mask = (size_t{1} << model.bits) - 1;
  for (size_t i = 0; i < entries.size(); i++) {
    const int first = i & mask ? entries[i - 1].first + entries[i - 1].frequency : 0;
    entries[i] = {model.frequencies[i], static_cast<uint16_t>(first)};
  }
  return entries;
}

template <int Symbols>
int symbol_at(const Entry* row, uint32_t slot) {
  int symbol = 0;
  for (int j = 1; j < Symbols; j++) symbol += row[j].first <= slot;
  return symbol;
}

template <int Bits>
int32_t decode(const CagsCodecSymbols& model, int64_t count, const uint8_t* data, int64_t bytes, int lanes, uint8_t* codes) {
  const std::vector<Entry> entries = entries_of(model);
  std::array<uint32_t, kMaxLanes> states;
  std::memcpy(states.data(), data, 4 * size_t(lanes));
  const uint8_t* word = data + 4 * lanes;
  const uint8_t* const end = data + bytes;
  const bool whole = for_runs(count, [&](int64_t first, int64_t distance, int64_t run) {
    for (int64_t at = 0, i = first, lane = 0; at < run; at++, i += distance, lane = lane + 1 == lanes ? 0 : lane + 1) {
      const Entry* row = entries.data() + (size_t(context_of(model, codes, i)) << Bits);
      const uint32_t state = states[lane], slot = state & (kTotal - 1);
      const int symbol = symbol_at<1 << Bits>(row, slot);
      codes[i] = static_cast<uint8_t>(symbol);
      uint32_t next = row[symbol].frequency * (state >> kProbabilityBits) + slot - row[symbol].first;
      if (next < kLow) {
        if (word == end) return false;
        uint16_t low;
        std::memcpy(&low, word, sizeof low);
        word += 2;
        next = next << 16 | low;
      }
      states[lane] = next;
    }
    return true;
  });
  if (!whole) return CAGS_CODEC_END;
  const bool done = word == end && std::all_of(states.begin(), states.begin() + lanes, [](uint32_t state) { return state == kLow; });
  return done ? int32_t{CAGS_OK} : int32_t{CAGS_CODEC_LEFT};
}

using Decode = int32_t (*)(const CagsCodecSymbols&, int64_t, const uint8_t*, int64_t, int, uint8_t*);
constexpr Decode kDecode[kMostBits + 1] = {nullptr, decode<1>, decode<2>, decode<3>, decode<4>};

void pack(const uint8_t* codes, int64_t count, int bits, uint8_t* packed, int64_t packed_bytes) {
  std::fill_n(packed, packed_bytes, uint8_t{0});
  for (int64_t i = 0, at = 0; i < count; i++, at += bits) {
    const unsigned shifted = unsigned{codes[i]} << (at & 7);
    packed[at >> 3] |= static_cast<uint8_t>(shifted);
    if (shifted >> 8) packed[(at >> 3) + 1] |= static_cast<uint8_t>(shifted >> 8);
  }
}

}  // namespace
}  // namespace cags::codec

using namespace cags::codec;

int32_t cags_codec_nearest(const float* cells, int64_t cells_length, int32_t* nearest, int64_t nearest_length) {
  if (cells_length < 0 || cells_length % 3 || cells_length / 3 > kMostSplats || nearest_length != cells_length / 3 * 2) {
    return CAGS_INVALID;
  }
  if (cells_length) find_nearest(cells, cells_length / 3, nearest);
  return CAGS_OK;
}

int32_t cags_codec_decode(const CagsCodecSymbols* model, const uint8_t* data, int64_t bytes, int64_t lanes, uint8_t* codes,
                          int64_t codes_length, uint8_t* packed, int64_t packed_length) {
  if (!valid(*model, codes_length) || packed_length != (codes_length * model->bits + 7) / 8) return CAGS_INVALID;
  if (lanes < 1 || lanes > kMaxLanes) return CAGS_INVALID;
  if (bytes < 4 * lanes || (bytes - 4 * lanes) % 2) return CAGS_CODEC_END;
  const int32_t status = kDecode[model->bits](*model, codes_length, data, bytes, static_cast<int>(lanes), codes);
  if (status == CAGS_OK) pack(codes, codes_length, model->bits, packed, packed_length);
  return status;
}

int32_t cags_codec_encode(const CagsCodecSymbols* model, const uint8_t* codes, int64_t codes_length, int64_t lanes,
                          uint32_t* states, int64_t states_length, uint16_t* words, int64_t words_length, int64_t* word_count) {
  if (!valid(*model, codes_length) || lanes < 1 || lanes > kMaxLanes) return CAGS_INVALID;
  if (states_length != lanes || words_length != codes_length) return CAGS_INVALID;
  if (std::any_of(codes, codes + codes_length, [&](uint8_t code) { return code >> model->bits; })) return CAGS_INVALID;
  const std::vector<Entry> entries = entries_of(*model);
  struct Step {
    Entry entry;
    uint32_t lane;
  };
  std::vector<Step> steps;
  steps.reserve(size_t(codes_length));
  for_runs(codes_length, [&](int64_t first, int64_t distance, int64_t run) {
    for (int64_t at = 0, i = first; at < run; at++, i += distance) {
      const size_t row = size_t(context_of(*model, codes, i)) << model->bits;
      steps.push_back({entries[row + codes[i]], static_cast<uint32_t>(at % lanes)});
    }
    return true;
  });
  std::fill_n(states, lanes, kLow);
  int64_t word = codes_length;
  for (auto step = steps.rbegin(); step != steps.rend(); ++step) {  // backwards, for words in the order of reading
    const uint32_t frequency = step->entry.frequency;
    uint32_t state = states[step->lane];
    if (state >= uint64_t{frequency} << (32 - kProbabilityBits)) words[--word] = static_cast<uint16_t>(state), state >>= 16;
    states[step->lane] = (state / frequency << kProbabilityBits) + state % frequency + step->entry.first;
  }
  *word_count = codes_length - word;
  std::copy(words + word, words + codes_length, words);
  return CAGS_OK;
}
