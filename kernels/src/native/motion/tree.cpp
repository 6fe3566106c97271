// Trees of residuals, both ways. Sums of untrusted numbers wrap, as numpy's do: unsigned arithmetic.
#include "motion/neighbours.h"
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
constexpr int kMostSpread = 756;
constexpr double kSpread = 28.0;
constexpr float kMostShift = 1 << 30;
constexpr int kSums = 3 * kMagnitude + kMostSpread + 3 * 2 * kMagnitude + 1;  // as cags_common.motion.contexts
constexpr int kParent = 1, kNear = 4, kKnown = kParent + kNear + 3;
constexpr int kWide = 4;  // numbers kept of a splat, whatever its parts

using Numbers = float __attribute__((vector_size(kWide * sizeof(float))));
using Whole = int32_t __attribute__((vector_size(kWide * sizeof(int32_t))));

bool valid(const CagsMotionTree& tree) {
  if (tree.span < 1 || tree.span > CAGS_MAX_SPAN || tree.splats < 0 || tree.splats > CAGS_MAX_TILE_SPLATS) return false;
  if (int64_t{tree.splats} * (tree.span + 1) > kMaxSamples || tree.knots < 0 || tree.knots > tree.span + 1) return false;
  if (tree.turn < 0 || tree.turn > 1 || tree.parts != 3 + tree.turn) return false;
  const auto [lowest, highest] = std::minmax({tree.first_table, tree.first_real_table, tree.silent_table});
  if (lowest < 0 || highest > kMaxTables - kClasses - 1) return false;
  if (tree.unit < 1 || tree.unit > 1 << 20 || !std::has_single_bit(static_cast<uint32_t>(tree.unit))) return false;
  const int64_t near = int64_t{CAGS_NEIGHBOURS} * tree.splats;
  const int64_t wanted[] = {kKnown * kSums, near, near * CAGS_FIT, tree.splats};
  if (!std::equal(std::begin(wanted), std::end(wanted), tree.lengths)) return false;
  auto known = [&](int32_t row) { return row >= 0 && row < tree.splats; };
  if (!std::all_of(tree.neighbours, tree.neighbours + near, known)) return false;
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
  const int64_t samples = samples_of(tree), residuals = int64_t{tree.knots} * tree.splats * tree.parts;
  const int64_t symbols = tree.knots + residuals;
  const int64_t wanted[] = {samples, samples, samples, symbols, symbols, residuals};
  return std::equal(std::begin(wanted), std::end(wanted), given.lengths);
}

int32_t wrapped_sum(int32_t a, int32_t b) { return static_cast<int32_t>(static_cast<uint32_t>(a) + static_cast<uint32_t>(b)); }
int32_t wrapped_product(int32_t a, int32_t b) {
  return static_cast<int32_t>(static_cast<uint32_t>(a) * static_cast<uint32_t>(b));
}
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
    std::copy_n(left, count, guess);
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
  const int32_t* guesses;  // [splats, kWide], from the group's first on
  int32_t* residuals;      // to be set
  uint8_t* activity;       // to which their magnitudes are added; null: they do not count
  const uint8_t* told;     // not 0: a coarser level told it apart, and it counts for nobody; null: none
};

Numbers magnitude_of(const Numbers& numbers) { return numbers < 0 ? -numbers : numbers; }

// The n-th of a sum.
Numbers added(int n, const Numbers& total, const Numbers& value) { return n ? total + value : value; }

float sum(const Numbers& numbers) { return ((numbers[0] + numbers[1]) + numbers[2]) + numbers[3]; }

// Rounded down, of numbers that fit.
Whole floor_of(const Numbers& numbers) {
  const Whole whole = __builtin_convertvector(numbers, Whole);
  return whole + (__builtin_convertvector(whole, Numbers) > numbers);  // true is -1
}

class Walk {
 public:
  explicit Walk(const CagsMotionTree& tree)
      : tree_(tree),
        off_(tree.splats),
        activity_(size_t(tree.splats) * (tree.span + 1)),
        coded_(tree.span + 1),
        guesses_(size_t(tree.splats) * kWide),
        spreads_(tree.splats),
        residuals_(kWide, std::vector<int32_t>(tree.splats)),
        size_(tree.splats),
        which_(tree.splats),
        told_(tree.splats),
        counted_(tree.splats) {}

  // Takes on the samples of a `knot` without residuals.
  void silent(const CagsKnot& knot, const int32_t* line, int32_t* samples, uint8_t* told) {
    const int64_t count = int64_t{tree_.splats} * tree_.parts;
    if (std::any_of(told, told + count, [](uint8_t value) { return value != 0; })) {  // others may follow those told
      auto none = [](const Run& run) -> int32_t { return std::fill_n(run.residuals, run.group.count, 0), CAGS_OK; };
      this->knot(knot, line, samples, told, none);
      return;
    }
    std::copy_n(line, count, samples);
    std::fill_n(activity_.data() + size_t(tree_.splats) * knot.at, tree_.splats, uint8_t{0});
    coded_[knot.at] = true;
  }

  // Goes through the residuals of `knot`: code(run) sets those of each run and returns a status. `line` [splats, parts]
  // is what the samples before lead to expect, `samples` of that shape are taken on, and so are those that are `told`.
  template <typename Code>
  int32_t knot(const CagsKnot& knot, const int32_t* line, int32_t* samples, uint8_t* told, const Code& code) {
    const int64_t count = int64_t{tree_.splats} * tree_.parts;
    const bool any_told = std::any_of(told, told + count, [](uint8_t value) { return value != 0; });
    uint8_t* activity = activity_.data() + size_t(tree_.splats) * knot.at;
    const bool has_parent = knot.parent >= 0 && coded_[knot.parent];
    const uint8_t* parent = has_parent ? activity_.data() + size_t(tree_.splats) * knot.parent : nullptr;
    std::fill(off_.begin(), off_.end(), Numbers{});
    for (int index = 0; index < kGroups; index++) {
      const Group group(index, tree_.splats);
      unit_ = (tree_.unit << kFractionBits) / group.finer, spread_unit_ = static_cast<float>(kSpread / unit_);
      std::fill_n(counted_.data(), group.count, uint8_t{0});
      for (int k = 0; k < group.count; k++) size_[k] = parent ? parent[group.splat(k)] : 0;
      for (int k = 0; k < group.count; k++) {
        if (!any_told || !all_told(told + int64_t{group.splat(k)} * tree_.parts)) expect(group, k, line);
      }
      if (any_told) keep(group, samples, told);
      const int known = kParent * has_parent + kNear * group.between;
      for (int part = tree_.turn; part < tree_.parts; part++) {
        choose(group.count, known + part - tree_.turn, part);
        if (any_told) set_apart(group, told + part, tree_.first_table + kClasses);
        if (const int32_t status = code(run(group, part, counted_.data(), any_told))) return status;
      }
      if (tree_.turn) {
        choose_real(group.count);
        if (any_told) set_apart(group, told, tree_.first_real_table + kRealClasses);
        if (const int32_t status = code(run(group, 0, nullptr, any_told))) return status;
      }
      for (int k = 0; k < group.count; k++) activity[group.splat(k)] = counted_[k];
      for (int k = 0; k < group.count; k++) settle(group.splat(k), k, line, samples, told);
    }
    coded_[knot.at] = true;
    return CAGS_OK;
  }

 private:
  Run run(const Group& group, int part, uint8_t* activity, bool any_told) {
    return {
        group, part, which_.data(), guesses_.data() + part, residuals_[part].data(), activity, any_told ? told_.data() : nullptr};
  }

  bool all_told(const uint8_t* told) const {
    return std::all_of(told, told + tree_.parts, [](uint8_t value) { return value != 0; });
  }

  // What the neighbours of the k-th splat lead to expect of it, and how uncertain that is.
  void expect(const Group& group, int k, const int32_t* line) {
    const int i = group.splat(k);
    const int32_t* near = tree_.neighbours + CAGS_NEIGHBOURS * i;
    const float* fits = tree_.fits + CAGS_NEIGHBOURS * CAGS_FIT * i;
    line += int64_t{tree_.parts} * i;
    Numbers offs[CAGS_NEIGHBOURS], size = {}, level = {}, slopes[3] = {};
    for (int n = 0; n < CAGS_NEIGHBOURS; n++) offs[n] = off_[near[n]], size += magnitude_of(offs[n]);
    if (sum(size) == 0.0f) {
      std::copy_n(line, tree_.parts, guesses_.data() + kWide * k), spreads_[k] = Whole{};
      return;
    }
    for (int n = 0; n < CAGS_NEIGHBOURS; n++) {
      const float* fit = fits + CAGS_FIT * n;
      for (int axis = 0; axis < 3; axis++) slopes[axis] = added(n, slopes[axis], offs[n] * fit[4 + axis]);
      level = added(n, level, offs[n] * fit[7]);
    }
    Numbers missed = {}, energy = {}, spread = {};
    for (int n = 0; n < CAGS_NEIGHBOURS; n++) {
      const float* fit = fits + CAGS_FIT * n;
      const Numbers fitted = ((level + fit[1] * slopes[0]) + fit[2] * slopes[1]) + fit[3] * slopes[2];
      const Numbers apart = offs[n] - fitted;
      missed = added(n, missed, apart * apart * fit[0]), energy = added(n, energy, offs[n] * offs[n] * fit[0]);
      spread = added(n, spread, magnitude_of(apart) * fit[0]);
    }
    const float left = sum(missed), all = sum(energy), unit = tree_.units[i];
    spread = spread / unit * spread_unit_;
    spreads_[k] = __builtin_convertvector(spread < kMostSpread ? spread : Numbers{} + kMostSpread, Whole);
    const Numbers shift = level * (left < all ? 1.0f - left / all : 0.0f) / unit;
    const Whole whole = floor_of((magnitude_of(shift) < kMostShift ? shift : Numbers{}) + 0.5f);
    for (int part = 0; part < tree_.parts; part++) guesses_[kWide * k + part] = wrapped_sum(line[part], whole[part]);
  }

  // What a coarser level told apart is not guessed again.
  void keep(const Group& group, const int32_t* samples, const uint8_t* told) {
    for (int k = 0; k < group.count; k++) {
      const int64_t first = int64_t{group.splat(k)} * tree_.parts;
      for (int part = 0; part < tree_.parts; part++) {
        if (told[first + part]) guesses_[kWide * k + part] = samples[first + part];
      }
    }
  }

  // Gives residuals that a coarser level told apart their own table.
  void set_apart(const Group& group, const uint8_t* told, int table) {
    for (int k = 0; k < group.count; k++) {
      told_[k] = told[int64_t{group.splat(k)} * tree_.parts] != 0;
      if (told_[k]) which_[k] = static_cast<uint8_t>(table);
    }
  }

  void choose(int count, int known, int part) {
    const uint8_t* __restrict classes = tree_.classes + known * kSums;
    const uint16_t* __restrict size = size_.data();
    const uint8_t* __restrict counted = counted_.data();
    uint8_t* __restrict which = which_.data();
    for (int k = 0; k < count; k++) {
      which[k] = static_cast<uint8_t>(tree_.first_table + classes[size[k] + spreads_[k][part] + 3 * counted[k]]);
    }
  }

  void choose_real(int count) {
    uint8_t* __restrict which = which_.data();
    for (int k = 0; k < count; k++) {
      const uint8_t a = counted_[k];
      which[k] = static_cast<uint8_t>(tree_.first_real_table + (a > 0) + (a > 2) + (a > 6));
    }
  }

  void settle(int i, int k, const int32_t* line, int32_t* samples, uint8_t* told) {
    const int64_t first = int64_t{i} * tree_.parts;
    for (int part = 0; part < tree_.parts; part++) {
      const int32_t residual = residuals_[part][k];
      const int32_t value = wrapped_sum(guesses_[kWide * k + part], wrapped_product(residual, unit_));
      samples[first + part] = value;
      off_[i][part] = static_cast<float>(int64_t{value} - line[first + part]) * tree_.units[i];
      told[first + part] = static_cast<uint8_t>(told[first + part] | (residual != 0));
    }
  }

  const CagsMotionTree& tree_;
  int32_t unit_ = 1;  // of the group, in 1/64 of the finest unit
  float spread_unit_ = 0.0f;
  std::vector<Numbers> off_;       // [splats] of what their line leads to expect; 0: not coded yet
  std::vector<uint8_t> activity_;  // [span + 1, splats]
  std::vector<bool> coded_;        // [span + 1]
  std::vector<int32_t> guesses_;   // of the group
  std::vector<Whole> spreads_;
  std::vector<std::vector<int32_t>> residuals_;
  std::vector<uint16_t> size_;
  std::vector<uint8_t> which_, told_, counted_;
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

int32_t decode(const CagsMotionTree& tree, SymbolDecoder& decoder, Escapes& escapes, uint8_t* told, int32_t* samples) {
  Walk walk(tree);
  const int64_t row_size = int64_t{tree.splats} * tree.parts;
  std::vector<uint8_t> symbols(tree.splats);
  std::vector<int32_t> line(row_size);
  const int last = std::max(tree.first_table + kClasses, tree.first_real_table + kRealClasses);
  const bool all_there = last < decoder.tables;
  if (tree.knots && tree.silent_table >= decoder.tables) return CAGS_SYMBOLS_TABLE;
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
    return CAGS_OK;
  };
  for (const CagsKnot* knot = tree.order; knot < tree.order + tree.knots; knot++) {
    predict(*knot, row_size, samples, line.data());
    int32_t* row = samples + knot->at * row_size;
    uint8_t *row_told = told + knot->at * row_size, silent;
    const uint8_t table = static_cast<uint8_t>(tree.silent_table);
    if (!decoder.take(1, &table, &silent)) return CAGS_SYMBOLS_END;
    if (silent) {
      walk.silent(*knot, line.data(), row, row_told);
    } else if (const int32_t status = walk.knot(*knot, line.data(), row, row_told, code)) {
      return status;
    }
  }
  return CAGS_OK;
}

struct Quantiser {
  double unit, deadzone;

  int32_t operator()(double wanted, int32_t guess, bool told, int finer) const {
    const double fixed = unit * (1 << kFractionBits) / finer;
    const double off = wanted * ((1 << kFractionBits) / fixed) - guess / fixed;
    const double size = std::fabs(off) + (told ? 0.5 : 0.5 - deadzone);
    const int32_t whole = size < 0x1p30 ? static_cast<int32_t>(size) : 1 << 30;
    return off < 0 ? -whole : whole;
  }
};

struct Written {
  uint8_t *tables, *symbols;
  int32_t* escapes;
  int64_t count = 0, escape_count = 0;

  // Writes the flag of a knot whose residuals follow.
  void begin(int table) { tables[count] = static_cast<uint8_t>(table), symbols[count++] = 0; }

  // Takes back the residuals of the knot that began at `first` where all of them are zero.
  void end(int64_t first) {
    if (std::any_of(symbols + first + 1, symbols + count, [](uint8_t symbol) { return symbol != 0; })) return;
    symbols[first] = 1, count = first + 1;
  }

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

void encode(const CagsMotionTree& tree, const CagsTreeEncoding& given, Written& out) {
  Walk walk(tree);
  const int64_t row_size = int64_t{tree.splats} * tree.parts;
  std::vector<int32_t> line(row_size);
  const Quantiser quantised{double(tree.unit), given.deadzone};
  for (const CagsKnot* knot = tree.order; knot < tree.order + tree.knots; knot++) {
    const double* wanted = given.wanted + knot->at * row_size;
    auto code = [&](const Run& run) -> int32_t {
      const Group& group = run.group;
      for (int k = 0; k < group.count; k++) {
        const double goal = wanted[int64_t{group.splat(k)} * tree.parts + run.part];
        run.residuals[k] = quantised(goal, run.guesses[kWide * k], run.told && run.told[k], group.finer);
        if (run.activity && !(run.told && run.told[k])) {
          run.activity[k] = static_cast<uint8_t>(run.activity[k] + magnitude(run.residuals[k]));
        }
      }
      out.put(run, run.residuals);
      return CAGS_OK;
    };
    predict(*knot, row_size, given.samples, line.data());
    const int64_t first = out.count;
    out.begin(tree.silent_table);
    walk.knot(*knot, line.data(), given.samples + knot->at * row_size, given.told + knot->at * row_size, code);
    out.end(first);
  }
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

int32_t cags_motion_encode_tree(const CagsMotionTree* tree, const CagsTreeEncoding* given, int64_t* written) {
  if (!valid(*tree) || !fits(*given, *tree)) return CAGS_INVALID;
  Written out{given->tables, given->symbols, given->escapes};
  const int32_t ran = cags::guarded([&] { encode(*tree, *given, out); });
  written[0] = out.count, written[1] = out.escape_count;
  return ran;
}
