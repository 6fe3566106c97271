// Codes by context: what a splat's neighbours along the Morton order have makes its own codes likely. The readable
// definition is cags_common.tiles.contexts; both give the same bytes.
#include "codec/cags_codec.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <limits>
#include <numeric>
#include <vector>

namespace cags::codec {
namespace {

constexpr int kProbabilityBits = 12, kTotal = 1 << kProbabilityBits;
constexpr int kMaxLanes = 32, kMostBits = 4, kMostPrefixBits = 6;
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

// Least and second least of candidates in their order: four squared distances, each with its number in two lower bits, so
// that minima find both without a branch, which could not be foretold. Whole numbers below 2^49 are exact.
void find_nearest(const float* cells, int64_t count, int32_t* nearest) {
  constexpr double kNowhere = double{int64_t{1} << 52};
  if (count) nearest[0] = nearest[1] = -1;
  for (int64_t i = 1; i < count; i++) {
    const int64_t step = i & -i;
    const int64_t candidates[4] = {i - step, i + step, i - 3 * step, i + 3 * step};
    const float* own = cells + 3 * i;
    double keys[4];
    for (int c = 0; c < 4; c++) {
      const bool known = candidates[c] >= 0 && candidates[c] < count;
      const float* other = cells + (known ? 3 * candidates[c] : 0);
      const double x = double{other[0]} - own[0], y = double{other[1]} - own[1], z = double{other[2]} - own[2];
      keys[c] = known ? 4 * (x * x + y * y + z * z) + c : kNowhere;
    }
    const double low = std::min(keys[0], keys[1]), high = std::max(keys[0], keys[1]);
    const double next_low = std::min(keys[2], keys[3]), next_high = std::max(keys[2], keys[3]);
    const double first = std::min(low, next_low);
    const double second = std::min(std::max(low, next_low), std::min(high, next_high));
    nearest[2 * i] = static_cast<int32_t>(first < kNowhere ? candidates[static_cast<int64_t>(first) & 3] : -1);
    nearest[2 * i + 1] = static_cast<int32_t>(second < kNowhere ? candidates[static_cast<int64_t>(second) & 3] : -1);
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
  int32_t least = 0, most = -1, prefixes = 0;
  for (int64_t i = 0; i < 2 * count; i++) {
    least = std::min(least, model.nearest[i]);
    most = std::max(most, model.nearest[i]);
  }
  for (int64_t i = 0; i < model.lengths[0]; i++) prefixes |= model.prefixes[i];
  return least >= -1 && most < count && !(prefixes >> model.prefix_bits);
}

// Of a further layer: context = start + the code at `at` of this layer, of which that at -2 is zero.
struct Neighbour {
  int32_t start, at;
};

void fill_neighbours(const CagsCodecSymbols& model, int64_t count, std::vector<Neighbour>& all) {
  all.resize(static_cast<size_t>(count));
  const int symbols = 1 << model.bits;
  for (int64_t i = 0; i < count; i++) {
    const int32_t first = model.nearest[2 * i], second = model.nearest[2 * i + 1];
    const int prefix = model.prefixes[i];
    const bool with_first = first >= 0 && model.prefixes[std::max(first, 0)] == prefix;
    const bool with_second = second >= 0 && model.prefixes[std::max(second, 0)] == prefix;
    const int state = with_first ? 1 : with_second ? 1 + symbols : 0;
    all[i] = {prefix * (1 + 2 * symbols) + state, with_first ? first : with_second ? second : -2};
  }
}

// Of a base code, by the near ones at `nearest` [2]; the code at -1 is none that there is.
int base_context(const int32_t* nearest, const uint8_t* codes) {
  if (nearest[0] < 0) return 0;
  const int first = codes[nearest[0]];
  return 2 * first + (first == codes[nearest[1]]);
}

// Rows of each context: sums of the frequencies before each symbol, and at the end the total.
template <int Symbols>
void fill_firsts(const CagsCodecSymbols& model, std::vector<int16_t>& firsts) {
  firsts.resize(size_t(model.lengths[2]) / Symbols * (Symbols + 1));
  int16_t* to = firsts.data();
  for (const uint16_t *row = model.frequencies, *end = row + model.lengths[2]; row < end; row += Symbols, to += Symbols + 1) {
    to[0] = 0;
    for (int symbol = 0; symbol < Symbols; symbol++) to[symbol + 1] = static_cast<int16_t>(to[symbol] + row[symbol]);
  }
}

template <int Symbols>
void fill_slots(const std::vector<int16_t>& firsts, std::vector<uint8_t>& slots) {
  const size_t contexts = firsts.size() / (Symbols + 1);
  slots.resize(contexts << kProbabilityBits);
  for (size_t context = 0; context < contexts; context++) {
    const int16_t* row = firsts.data() + context * (Symbols + 1);
    for (int symbol = 0; symbol < Symbols; symbol++) {
      std::memset(slots.data() + (context << kProbabilityBits) + row[symbol], symbol, size_t(row[symbol + 1] - row[symbol]));
    }
  }
}

// Memory that one thread uses again: fresh pages would cost as much as decoding.
struct Workspace {
  std::vector<Neighbour> near;
  std::vector<int16_t> firsts;
  std::vector<uint8_t> slots, codes, words;
};

Workspace& workspace() {
#ifdef __wasm__
  static Workspace& own = *new Workspace;  // the browser's module has one thread and no end
#else
  thread_local Workspace own;
#endif
  return own;
}

template <int Bits, bool Lowest>
int32_t decode_layer(const CagsCodecSymbols& model, int64_t count, const uint8_t* data, int64_t bytes, int lanes, uint8_t* out) {
  constexpr int kSymbols = 1 << Bits;
  constexpr bool kSlots = Lowest && kSymbols > 4;  // few contexts and many symbols: a table says the symbol of each slot
  Workspace& own = workspace();
  fill_firsts<kSymbols>(model, own.firsts);
  if (kSlots) fill_slots<kSymbols>(own.firsts, own.slots);
  if (!Lowest) fill_neighbours(model, count, own.near);
  own.codes.assign(size_t(count) + 2, 0);
  uint8_t* const codes = own.codes.data() + 2;
  codes[-1] = 0xFF, codes[-2] = 0;  // of none: the same as no code, and zero
  own.words.assign(data + 4 * lanes, data + bytes);
  own.words.resize(own.words.size() + 2 * kMaxLanes);  // a row may read so far beyond the end
  std::array<uint32_t, kMaxLanes> states;
  std::memcpy(states.data(), data, 4 * size_t(lanes));
  const uint8_t *word = own.words.data(), *const end = word + bytes - 4 * lanes;
  const int16_t* const firsts = own.firsts.data();
  const uint8_t* const slots = own.slots.data();
  const Neighbour* const near = own.near.data();
  const bool whole = for_runs(count, [&](int64_t first, int64_t distance, int64_t run) {
    int64_t i = first;
    for (int64_t row = 0; row < run; row += lanes) {
      const int width = static_cast<int>(std::min<int64_t>(lanes, run - row));
      for (int lane = 0; lane < width; lane++, i += distance) {
        const int context = Lowest ? base_context(model.nearest + 2 * i, codes) : near[i].start + codes[near[i].at];
        const int16_t* at = firsts + context * (kSymbols + 1);
        const uint32_t state = states[lane];
        const int slot = static_cast<int>(state & (kTotal - 1));
        int symbol = 0;
        if (kSlots) {
          symbol = slots[context << kProbabilityBits | slot];
        } else {
          for (int j = 1; j < kSymbols; j++) symbol += at[j] <= slot;
        }
        codes[i] = static_cast<uint8_t>(symbol);
        const uint32_t frequency = static_cast<uint32_t>(at[symbol + 1] - at[symbol]);
        const uint32_t next = frequency * (state >> kProbabilityBits) + static_cast<uint32_t>(slot - at[symbol]);
        const uint32_t low = next < kLow;  // no branch: it could not be foretold
        uint16_t bits;
        std::memcpy(&bits, word, sizeof bits);
        states[lane] = next << (low << 4) | (bits & (0 - low));
        word += 2 * low;
      }
      if (word > end) return false;
    }
    return true;
  });
  if (!whole) return CAGS_CODEC_END;
  std::copy_n(codes, count, out);
  const bool done =
      word == end && std::all_of(states.begin(), states.begin() + lanes, [](uint32_t state) { return state == kLow; });
  return done ? int32_t{CAGS_OK} : int32_t{CAGS_CODEC_LEFT};
}

template <int Bits>
int32_t decode(const CagsCodecSymbols& model, int64_t count, const uint8_t* data, int64_t bytes, int lanes, uint8_t* codes) {
  const auto call = model.prefix_bits ? decode_layer<Bits, false> : decode_layer<Bits, true>;
  return call(model, count, data, bytes, lanes, codes);
}

using Decode = int32_t (*)(const CagsCodecSymbols&, int64_t, const uint8_t*, int64_t, int, uint8_t*);
constexpr Decode kDecode[kMostBits + 1] = {nullptr, decode<1>, decode<2>, decode<3>, decode<4>};

template <int Bits>
void pack(const uint8_t* codes, int64_t count, uint8_t* packed) {
  constexpr int kCodes = 8 / Bits;  // of a byte, but for three bits
  if (8 % Bits == 0) {
    for (int64_t byte = 0; byte < count / kCodes; byte++) {
      unsigned together = 0;
      for (int code = 0; code < kCodes; code++) together |= unsigned{codes[byte * kCodes + code]} << (code * Bits);
      packed[byte] = static_cast<uint8_t>(together);
    }
  }
  const int64_t whole = 8 % Bits == 0 ? count / kCodes * kCodes : 0;
  std::fill(packed + whole * Bits / 8, packed + (count * Bits + 7) / 8, uint8_t{0});
  for (int64_t i = whole, at = whole * Bits; i < count; i++, at += Bits) {
    const unsigned shifted = unsigned{codes[i]} << (at & 7);
    packed[at >> 3] |= static_cast<uint8_t>(shifted);
    if (shifted >> 8) packed[(at >> 3) + 1] |= static_cast<uint8_t>(shifted >> 8);
  }
}

using Pack = void (*)(const uint8_t*, int64_t, uint8_t*);
constexpr Pack kPack[kMostBits + 1] = {nullptr, pack<1>, pack<2>, pack<3>, pack<4>};

}  // namespace
}  // namespace cags::codec

using namespace cags::codec;

int32_t cags_codec_nearest(const float* cells, int64_t cells_length, int32_t* nearest, int64_t nearest_length) {
  if (cells_length < 0 || cells_length % 3 || cells_length / 3 > kMostSplats || nearest_length != cells_length / 3 * 2) {
    return CAGS_INVALID;
  }
  constexpr float kMost = float{1 << 23};
  for (int64_t i = 0; i < cells_length; i++) {
    if (!(cells[i] >= 0 && cells[i] < kMost)) return CAGS_INVALID;
  }
  find_nearest(cells, cells_length / 3, nearest);
  return CAGS_OK;
}

int32_t cags_codec_decode(const CagsCodecSymbols* model, const uint8_t* data, int64_t bytes, int64_t lanes, uint8_t* codes,
                          int64_t codes_length, uint8_t* packed, int64_t packed_length) {
  if (!valid(*model, codes_length) || packed_length != (codes_length * model->bits + 7) / 8) return CAGS_INVALID;
  if (lanes < 1 || lanes > kMaxLanes) return CAGS_INVALID;
  if (bytes < 4 * lanes || (bytes - 4 * lanes) % 2) return CAGS_CODEC_END;
  const int32_t status = kDecode[model->bits](*model, codes_length, data, bytes, static_cast<int>(lanes), codes);
  if (status == CAGS_OK) kPack[model->bits](codes, codes_length, packed);
  return status;
}

int32_t cags_codec_encode(const CagsCodecSymbols* model, const uint8_t* codes, int64_t codes_length, int64_t lanes,
                          uint32_t* states, int64_t states_length, uint16_t* words, int64_t words_length, int64_t* word_count) {
  if (!valid(*model, codes_length) || lanes < 1 || lanes > kMaxLanes) return CAGS_INVALID;
  if (states_length != lanes || words_length != codes_length) return CAGS_INVALID;
  if (std::any_of(codes, codes + codes_length, [&](uint8_t code) { return code >> model->bits; })) return CAGS_INVALID;
  struct Step {
    uint32_t frequency, first, lane;
  };
  std::vector<Step> steps;
  steps.reserve(size_t(codes_length));
  std::vector<Neighbour> near;
  if (model->prefix_bits) fill_neighbours(*model, codes_length, near);
  std::vector<uint8_t> held(size_t(codes_length) + 2);
  held[0] = 0, held[1] = 0xFF;
  uint8_t* const known = held.data() + 2;
  std::copy_n(codes, codes_length, known);
  for_runs(codes_length, [&](int64_t first, int64_t distance, int64_t run) {
    for (int64_t at = 0, i = first; at < run; at++, i += distance) {
      const int context = model->prefix_bits ? near[i].start + known[near[i].at] : base_context(model->nearest + 2 * i, known);
      const uint16_t* row = model->frequencies + (int64_t{context} << model->bits);
      const uint32_t before = std::accumulate(row, row + codes[i], uint32_t{0});
      steps.push_back({row[codes[i]], before, static_cast<uint32_t>(at % lanes)});
    }
    return true;
  });
  std::fill_n(states, lanes, kLow);
  int64_t word = codes_length;
  for (auto step = steps.rbegin(); step != steps.rend(); ++step) {  // backwards, for words in the order of reading
    const uint32_t frequency = step->frequency;
    uint32_t state = states[step->lane];
    if (state >= uint64_t{frequency} << (32 - kProbabilityBits)) words[--word] = static_cast<uint16_t>(state), state >>= 16;
    states[step->lane] = (state / frequency << kProbabilityBits) + state % frequency + step->first;
  }
  *word_count = codes_length - word;
  std::copy(words + word, words + codes_length, words);
  return CAGS_OK;
}
