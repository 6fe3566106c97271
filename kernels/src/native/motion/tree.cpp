// Trees of residuals, both ways. Sums of untrusted numbers wrap, as numpy's do: unsigned arithmetic.
#include "motion/lattice.h"
#include "motion/symbols.h"
#include "support/guarded.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace cags::motion {
namespace {

constexpr int64_t kMaxSamples = int64_t{1} << 20;
constexpr int kFractionBits = 6, kWeightBits = 12;
constexpr int kEscape = 254;
constexpr int kMagnitude = 63, kClasses = 10, kRealClasses = 4;  // and one more table each: residuals told before
constexpr int kSums = 2 * 3 * kMagnitude + 2 * 6 * kMagnitude + 3 * 2 * kMagnitude + 1;  // as cags_common.motion.contexts
constexpr int kKnown = 9;

bool valid(const CagsMotionTree& tree) {
  if (tree.span < 1 || tree.span > CAGS_MAX_SPAN || tree.splats < 0 || tree.splats > CAGS_MAX_TILE_SPLATS) return false;
  if (int64_t{tree.splats} * (tree.span + 1) > kMaxSamples || tree.knots < 0 || tree.knots > tree.span + 1) return false;
  if (tree.turn < 0 || tree.turn > 1 || tree.parts != 3 + tree.turn) return false;
  if (std::min(tree.first_table, tree.first_real_table) < 0 || std::max(tree.first_table, tree.first_real_table) > 32)
    return false;
  if (tree.classes_length != kKnown * kSums) return false;
  if (std::any_of(tree.classes, tree.classes + kKnown * kSums, [](uint8_t c) { return c >= kClasses; })) return false;
  auto within = [&](int32_t sample) { return sample >= 0 && sample <= tree.span; };
  return std::all_of(tree.order, tree.order + tree.knots, [&](const CagsKnot& knot) {
    const bool samples = within(knot.at) && within(knot.left) && within(knot.right);
    const bool between = knot.kind != CAGS_KNOT_MIDDLE || (knot.left < knot.at && knot.at < knot.right);
    const bool kind = knot.kind >= 0 && knot.kind <= 2 && (knot.parent == -1 || within(knot.parent));
    auto beyond = [&](int32_t sample, int32_t weight) {
      return sample == -1 || (within(sample) && knot.kind == CAGS_KNOT_MIDDLE && std::abs(weight) <= 1 << kWeightBits);
    };
    return samples && between && kind && beyond(knot.before, knot.weight_before) && beyond(knot.after, knot.weight_after);
  });
}

int64_t samples_of(const CagsMotionTree& tree) { return int64_t{tree.span + 1} * tree.splats * tree.parts; }

bool fits(const CagsTreeEncoding& given, const CagsMotionTree& tree) {
  const int64_t samples = samples_of(tree), symbols = int64_t{tree.knots} * tree.splats * tree.parts;
  const int64_t wanted[] = {samples, samples, symbols, symbols, symbols};
  return std::equal(std::begin(wanted), std::end(wanted), given.lengths);
}

int32_t wrapped_sum(int32_t a, int32_t b) { return static_cast<int32_t>(static_cast<uint32_t>(a) + static_cast<uint32_t>(b)); }
int32_t fixed(int32_t residual) { return static_cast<int32_t>(static_cast<uint32_t>(residual) << kFractionBits); }
int32_t half_of_sum(int32_t a, int32_t b) { return (a >> 1) + (b >> 1) + (a & b & 1); }  // rounded down, of the whole sum

int magnitude(int32_t residual) {
  const uint32_t size = residual < 0 ? 0u - static_cast<uint32_t>(residual) : static_cast<uint32_t>(residual);
  return static_cast<int>(std::min<uint32_t>(size, kMagnitude));
}

// Rounded down; |rise| < 2^39 and width < 2^7, so a quotient that is not whole is further from being so than it is rounded.
int64_t floor_of_quotient(int64_t rise, int32_t width) {
  const int64_t whole = static_cast<int64_t>(static_cast<double>(rise) / width);
  return whole - (whole * width > rise);
}

// What `far` is off the line through `left` and `right`, `way` from the left one; differences in 64 bits.
struct OffLine {
  const int32_t *far, *left, *right;
  int32_t way, width;

  int64_t operator()(int64_t i) const {
    const int64_t rise = int64_t{right[i]} - left[i];
    const int64_t line = way % width == 0 ? rise * (way / width) : floor_of_quotient(rise * way, width);
    return int64_t{far[i]} - left[i] - line;
  }
};

// Bends the line `guess` to the curve that goes through the samples beyond the ends of the interval of `knot`, too.
void bend(const CagsKnot& knot, int64_t count, const int32_t* samples, int32_t* guess) {
  auto off = [&](int32_t at) {
    const int32_t far = at < 0 ? knot.left : at;
    return OffLine{samples + far * count, samples + knot.left * count, samples + knot.right * count, far - knot.left,
                   knot.right - knot.left};
  };
  const OffLine before = off(knot.before), after = off(knot.after);
  const int32_t weights[] = {knot.before < 0 ? 0 : knot.weight_before, knot.after < 0 ? 0 : knot.weight_after};
  for (int64_t i = 0; i < count; i++) {
    const int64_t bent = (weights[0] * before(i) + weights[1] * after(i)) >> kWeightBits;
    guess[i] = wrapped_sum(guess[i], static_cast<int32_t>(bent));
  }
}

// What the samples before `knot` lead to expect of it, for `count` numbers of a row.
void predict(const CagsKnot& knot, int64_t count, const int32_t* samples, int32_t* guess) {
  const int32_t* left = samples + knot.left * count;
  const int32_t* right = samples + knot.right * count;
  const int32_t width = knot.right - knot.left, way = knot.at - knot.left;
  if (knot.kind == CAGS_KNOT_START) {
    std::fill_n(guess, count, 0);
  } else if (knot.kind == CAGS_KNOT_END) {
    if (guess != left) std::copy_n(left, count, guess);
  } else if (width == 2 * way) {
    for (int64_t i = 0; i < count; i++) guess[i] = half_of_sum(left[i], right[i]);
  } else {
    for (int64_t i = 0; i < count; i++) {
      const int64_t rise = (int64_t{right[i]} - left[i]) * way;
      guess[i] = wrapped_sum(left[i], static_cast<int32_t>(floor_of_quotient(rise, width)));
    }
  }
  if (knot.before >= 0 || knot.after >= 0) bend(knot, count, samples, guess);
}

// One part of the splats of a group on its way.
struct Run {
  const Group& group;
  int part;
  const uint8_t* tables;
  const int32_t* left;  // residuals of neighbours, each run's i-th between [i] and [i + 1]; null: none
  int32_t* residuals;   // to be set
  uint8_t* activity;    // to which their magnitudes are added; null: they do not count
  const uint8_t* told;  // not 0: a coarser level told it apart, and it counts for nobody; null: none
};

class Walk {
 public:
  explicit Walk(const CagsMotionTree& tree)
      : tree_(tree),
        residuals_(tree.parts, Lattice<int32_t>(tree.splats)),
        activity_(tree.splats),
        all_activity_(size_t(tree.splats) * (tree.span + 1)),
        coded_(tree.span + 1),
        size_(tree.splats),
        which_(tree.splats),
        told_(tree.splats) {}

  // [splats] of the last knot.
  const int32_t* residuals(int part) const { return residuals_[part].left(); }

  // Goes through the residuals of `knot`: code(run) sets those of each run and returns a status. `told` [splats, parts]
  // are not 0 where a coarser level told them apart.
  template <typename Code>
  int32_t knot(const CagsKnot& knot, const uint8_t* told, const Code& code) {
    const size_t all_told = size_t(tree_.splats) * tree_.parts;
    if (std::none_of(told, told + all_told, [](uint8_t value) { return value != 0; })) told = nullptr;
    uint8_t* all = all_activity_.data() + size_t(tree_.splats) * knot.at;
    const bool has_parent = knot.parent >= 0 && coded_[knot.parent];
    const uint8_t* parent = has_parent ? all_activity_.data() + size_t(tree_.splats) * knot.parent : nullptr;
    activity_.clear();
    for (Lattice<int32_t>& part : residuals_) part.clear();
    for (int index = 0; index < int(std::size(kStrides)); index++) {
      const Group group(index, tree_.splats);
      uint8_t* activity = activity_.fresh();
      std::fill_n(activity, group.count, uint8_t{0});
      measure(group, parent);
      const int known = 2 * has_parent + 4 * group.between;
      for (int part = tree_.turn; part < tree_.parts; part++) {
        choose(group.count, activity, known + part - tree_.turn);
        if (told) set_apart(group, told + part, tree_.first_table + kClasses);
        if (const int32_t status = code(run(group, part, activity, told))) return status;
      }
      if (tree_.turn) {
        choose_real(group.count, activity);
        if (told) set_apart(group, told, tree_.first_real_table + kRealClasses);
        if (const int32_t status = code(run(group, 0, nullptr, told))) return status;
      }
      all = std::copy_n(activity, group.count, all);
      if (parent) parent += group.count;
      activity_.merge(group);
      for (Lattice<int32_t>& part : residuals_) part.merge(group);
    }
    coded_[knot.at] = true;
    return CAGS_OK;
  }

 private:
  Run run(const Group& group, int part, uint8_t* activity, const uint8_t* told) {
    Lattice<int32_t>& lattice = residuals_[part];
    const int32_t* left = group.between ? lattice.left() : nullptr;
    return {group, part, which_.data(), left, lattice.fresh(), activity, told ? told_.data() : nullptr};
  }

  // Gives residuals that a coarser level told apart their own table.
  void set_apart(const Group& group, const uint8_t* told, int table) {
    const int64_t step = int64_t{group.step} * tree_.parts;
    told += int64_t{group.first} * tree_.parts;
    for (int i = 0; i < group.count; i++) {
      told_[i] = told[i * step] != 0;
      if (told_[i]) which_[i] = static_cast<uint8_t>(table);
    }
  }

  void measure(const Group& group, const uint8_t* parent) {
    uint16_t* __restrict size = size_.data();
    const uint8_t* __restrict left = activity_.left();
    const int count = group.count;
    std::fill_n(size, count, uint16_t{0});
    if (parent) {
      for (int i = 0; i < count; i++) size[i] = static_cast<uint16_t>(2 * parent[i]);
    }
    if (group.between) {
      for (int i = 0; i < count; i++) size[i] = static_cast<uint16_t>(size[i] + 2 * (left[i] + left[i + 1]));
    }
  }

  void choose(int count, const uint8_t* activity, int known) {
    const uint8_t* __restrict classes = tree_.classes + known * kSums;
    const uint16_t* __restrict size = size_.data();
    const int first = tree_.first_table;
    uint8_t* __restrict which = which_.data();
    for (int i = 0; i < count; i++) which[i] = static_cast<uint8_t>(first + classes[size[i] + 3 * activity[i]]);
  }

  void choose_real(int count, const uint8_t* activity) {
    uint8_t* __restrict which = which_.data();
    const uint8_t first = static_cast<uint8_t>(tree_.first_real_table);
    for (int i = 0; i < count; i++) {
      const uint8_t a = activity[i];
      which[i] = static_cast<uint8_t>(first + (a > 0) + (a > 2) + (a > 6));
    }
  }

  const CagsMotionTree& tree_;
  std::vector<Lattice<int32_t>> residuals_;
  Lattice<uint8_t> activity_;
  std::vector<uint8_t> all_activity_;  // [span + 1, splats] in the order of coding
  std::vector<bool> coded_;
  std::vector<uint16_t> size_;
  std::vector<uint8_t> which_, told_;
};

struct Escapes {
  const uint8_t* data;
  int64_t count, at;

  bool next(int32_t& value) {
    if (at >= count) return false;
    std::memcpy(&value, data + 4 * at++, sizeof value);
    return true;
  }
};

// Pointers that do not overlap, said to the compiler: bytes may be anything otherwise.
void unfold(const Run& run, const uint8_t* __restrict symbols) {
  const int count = run.group.count;
  int32_t* __restrict out = run.residuals;
  for (int i = 0; i < count; i++) out[i] = symbols[i] >> 1 ^ -(symbols[i] & 1);
  uint8_t* __restrict activity = run.activity;
  if (!activity) return;
  const uint8_t* __restrict told = run.told;
  for (int i = 0; i < count; i++) {
    const uint8_t size = static_cast<uint8_t>((symbols[i] + 1) >> 1);
    const uint8_t counted = std::min<uint8_t>(size, kMagnitude);
    activity[i] = static_cast<uint8_t>(activity[i] + (told && told[i] ? 0 : counted));
  }
}

// The same where some are escapes.
bool unfold(const Run& run, const uint8_t* symbols, Escapes& escapes) {
  for (int i = 0; i < run.group.count; i++) {
    int32_t value = symbols[i] >> 1 ^ -(symbols[i] & 1);
    if (symbols[i] == kEscape && !escapes.next(value)) return false;
    run.residuals[i] = value;
    if (run.activity && !(run.told && run.told[i])) run.activity[i] = static_cast<uint8_t>(run.activity[i] + magnitude(value));
  }
  return true;
}

void flip(const Run& run, int32_t* out) {
  const int count = run.group.count;
  const int32_t* __restrict left = run.left;
  const int32_t* residuals = run.residuals;
  for (int i = 0; i < count; i++) {
    const int32_t sign = half_of_sum(left[i], left[i + 1]) >> 31;
    out[i] = wrapped_sum(residuals[i] ^ sign, -sign);
  }
}

// To guesses, which count for nothing where a coarser level told the residuals apart; and those that there are become told.
template <int Parts>
void add_residuals(const Walk& walk, int splats, int32_t* __restrict sample, uint8_t* __restrict told) {
  const int32_t* planes[Parts];
  for (int part = 0; part < Parts; part++) planes[part] = walk.residuals(part);
  for (int i = 0; i < splats; i++, sample += Parts, told += Parts) {
    for (int part = 0; part < Parts; part++) {
      const int32_t residual = planes[part][i];
      sample[part] = wrapped_sum(told[part] ? 0 : sample[part], fixed(residual));
      told[part] = static_cast<uint8_t>(told[part] | (residual != 0));
    }
  }
}

int32_t decode(const CagsMotionTree& tree, SymbolDecoder& decoder, Escapes& escapes, uint8_t* told, int32_t* samples) {
  Walk walk(tree);
  std::vector<uint8_t> symbols(tree.splats);
  const int64_t row_size = int64_t{tree.splats} * tree.parts;
  std::fill_n(samples, row_size * (tree.span + 1), 0);
  const bool all_there = std::max(tree.first_table + kClasses, tree.first_real_table + kRealClasses) < decoder.tables;
  auto code = [&](const Run& run) -> int32_t {
    const int count = run.group.count;
    if (!all_there && std::any_of(run.tables, run.tables + count, [&](uint8_t t) { return t >= decoder.tables; })) {
      return CAGS_SYMBOLS_TABLE;
    }
    if (!decoder.take(count, run.tables, symbols.data())) return CAGS_SYMBOLS_END;
    if (!count || !std::memchr(symbols.data(), kEscape, count)) {
      unfold(run, symbols.data());
    } else if (!unfold(run, symbols.data(), escapes)) {
      return CAGS_ESCAPES_END;
    }
    if (run.left) flip(run, run.residuals);
    return CAGS_OK;
  };
  for (const CagsKnot* knot = tree.order; knot < tree.order + tree.knots; knot++) {
    int32_t* sample = samples + knot->at * row_size;
    uint8_t* apart = told + knot->at * row_size;
    if (const int32_t status = walk.knot(*knot, apart, code)) return status;
    predict(*knot, row_size, samples, sample);
    tree.turn ? add_residuals<4>(walk, tree.splats, sample, apart) : add_residuals<3>(walk, tree.splats, sample, apart);
  }
  return CAGS_OK;
}

struct Quantiser {
  double to_units, deadzone;

  int32_t operator()(double wanted, int32_t guess, bool told) const {
    const double off = wanted * to_units - guess * (1.0 / (1 << kFractionBits));
    const double size = std::fabs(off) + (told ? 0.5 : 0.5 - deadzone);
    const int32_t whole = size < 0x1p30 ? static_cast<int32_t>(size) : 1 << 30;
    return off < 0 ? -whole : whole;
  }
};

struct Written {
  uint8_t *tables, *symbols;
  int32_t* escapes;
  int64_t count = 0, escape_count = 0;

  // Writes a run of `values`, each by its table.
  void put(const Run& run, const int32_t* __restrict values) {
    const int size = run.group.count;
    uint8_t* __restrict to = symbols + count;
    std::copy_n(run.tables, size, tables + count);
    for (int i = 0; i < size; i++) {
      const uint32_t folded = static_cast<uint32_t>(values[i]) << 1 ^ static_cast<uint32_t>(values[i] >> 31);
      to[i] = static_cast<uint8_t>(folded < kEscape ? folded : kEscape);
    }
    count += size;
    if (!size || !std::memchr(to, kEscape, size)) return;
    for (int i = 0; i < size; i++) {
      if (to[i] == kEscape) escapes[escape_count++] = values[i];
    }
  }
};

void encode(const CagsMotionTree& tree, double* left, uint8_t* told, int32_t unit, double deadzone, Written& out) {
  Walk walk(tree);
  const int64_t row_size = int64_t{tree.splats} * tree.parts, all = row_size * (tree.span + 1);
  std::vector<int32_t> samples(all), residuals(row_size + 1), values(tree.splats + 1);
  const Quantiser quantised{1.0 / unit, deadzone};
  auto code = [&](const Run& run) -> int32_t {
    const int64_t step = int64_t{run.group.step} * tree.parts;
    const int32_t* from = residuals.data() + int64_t{run.group.first} * tree.parts + run.part;
    const int size = run.group.count;
    int32_t* __restrict to = run.residuals;
    for (int i = 0; i < size; i++) to[i] = from[i * step];
    uint8_t* __restrict activity = run.activity;
    for (int i = 0; activity && i < size; i++) {
      if (!run.told || !run.told[i]) activity[i] = static_cast<uint8_t>(activity[i] + magnitude(to[i]));
    }
    if (!run.left) {
      out.put(run, to);
    } else {
      flip(run, values.data());
      out.put(run, values.data());
    }
    return CAGS_OK;
  };
  for (const CagsKnot* knot = tree.order; knot < tree.order + tree.knots; knot++) {
    int32_t* sample = samples.data() + knot->at * row_size;
    predict(*knot, row_size, samples.data(), sample);
    const double* wanted = left + knot->at * row_size;
    uint8_t* apart = told + knot->at * row_size;
    for (int64_t i = 0; i < row_size; i++) {
      const int32_t guess = apart[i] ? 0 : sample[i];
      residuals[i] = quantised(wanted[i], guess, apart[i]);
      sample[i] = wrapped_sum(guess, fixed(residuals[i]));
    }
    walk.knot(*knot, apart, code);
    for (int64_t i = 0; i < row_size; i++) apart[i] = static_cast<uint8_t>(apart[i] | (residuals[i] != 0));
  }
  const double scale = unit * (1.0 / (1 << kFractionBits));
  for (int64_t i = 0; i < all; i++) left[i] -= samples[i] * scale;
}

}  // namespace
}  // namespace cags::motion

using namespace cags::motion;

int32_t cags_motion_decode_tree(const CagsMotionTree* tree, void* decoder, const uint8_t* escapes, int64_t escapes_length,
                                int64_t* escape, uint8_t* told, int64_t told_length, int32_t* samples, int64_t samples_length) {
  if (!valid(*tree) || escapes_length < 0 || *escape < 0) return CAGS_INVALID;
  if (told_length != samples_of(*tree) || samples_length != told_length) return CAGS_INVALID;
  int32_t status = CAGS_OK;
  Escapes large{escapes, escapes_length, *escape};
  const int32_t ran = cags::guarded([&] { status = decode(*tree, *static_cast<SymbolDecoder*>(decoder), large, told, samples); });
  *escape = large.at;
  return ran == CAGS_OK ? status : ran;
}

int32_t cags_motion_encode_tree(const CagsMotionTree* tree, const CagsTreeEncoding* given, int64_t* escape_count) {
  const int32_t unit = given->unit;
  if (!valid(*tree) || !fits(*given, *tree) || unit < 1 || !std::has_single_bit(static_cast<uint32_t>(unit))) return CAGS_INVALID;
  Written out{given->tables, given->symbols, given->escapes};
  const int32_t ran = cags::guarded([&] { encode(*tree, given->left, given->told, unit, given->deadzone, out); });
  *escape_count = out.escape_count;
  return ran;
}
