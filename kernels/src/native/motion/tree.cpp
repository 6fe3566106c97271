// Trees of residuals, both ways. Sums of untrusted numbers wrap, as numpy's do: unsigned arithmetic.
#include "motion/symbols.h"
#include "support/calls.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace cags::motion {
namespace {

constexpr int kMaxSpan = 64, kMaxSplats = 1 << 16;
constexpr int64_t kMaxSamples = int64_t{1} << 20;
constexpr int kFractionBits = 6;
constexpr int kEscape = 254;
constexpr int kMagnitude = 63;
constexpr int kSums = 2 * 3 * kMagnitude + 2 * 6 * kMagnitude + 3 * 2 * kMagnitude + 1;  // as cags_common.motion.contexts
constexpr int kStrides[] = {32, 16, 8, 4, 2, 1};



bool valid(const CagsMotionTree& tree) {
  if (tree.span < 1 || tree.span > kMaxSpan || tree.splats < 0 || tree.splats > kMaxSplats) return false;
  if (int64_t{tree.splats} * (tree.span + 1) > kMaxSamples || tree.knots < 0 || tree.knots > tree.span + 1) return false;
  if (tree.parts != (tree.turn ? 4 : 3)) return false;
  auto within = [&](int32_t sample) { return sample >= 0 && sample <= tree.span; };
  return std::all_of(tree.order, tree.order + tree.knots, [&](const CagsKnot& knot) {
    const bool samples = within(knot.at) && within(knot.left) && within(knot.right);
    const bool between = knot.kind != CAGS_KNOT_MIDDLE || (knot.left < knot.at && knot.at < knot.right);
    return samples && between && knot.kind >= 0 && knot.kind <= 2 && (knot.parent == -1 || within(knot.parent));
  });
}

int32_t wrapped_sum(int32_t a, int32_t b) { return static_cast<int32_t>(static_cast<uint32_t>(a) + static_cast<uint32_t>(b)); }
int32_t wrapped_negative(int32_t a) { return static_cast<int32_t>(0u - static_cast<uint32_t>(a)); }
int32_t fixed(int32_t residual) { return static_cast<int32_t>(static_cast<uint32_t>(residual) << kFractionBits); }
int magnitude(int32_t residual) { return static_cast<int>(std::min<int64_t>(std::abs(int64_t{residual}), kMagnitude)); }

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
    for (int64_t i = 0; i < count; i++) {
      guess[i] = wrapped_sum(left[i], static_cast<int32_t>((int64_t{right[i]} - left[i]) >> 1));
    }
  } else {
    for (int64_t i = 0; i < count; i++) {
      const int64_t rise = (int64_t{right[i]} - left[i]) * way, whole = rise / width;
      guess[i] = wrapped_sum(left[i], static_cast<int32_t>(whole - (rise % width < 0)));
    }
  }
}

// Splats that are coded together: `first`, `first + step`, ...; those after the first group have neighbours.
struct Group {
  int first, step, count;
  int stride;  // to the neighbours; 0: none

  Group(int index, int splats) {
    stride = index == 0 ? 0 : kStrides[index];
    first = stride, step = index == 0 ? kStrides[0] : 2 * stride;
    count = splats > first ? (splats - first + step - 1) / step : 0;
  }
  int left(int row) const { return row - stride; }
  int right(int row, int splats) const { return row + stride < splats ? row + stride : row - stride; }
};

class Walk {
 public:
  explicit Walk(const CagsMotionTree& tree)
      : tree_(tree),
        residuals_(size_t(tree.splats) * tree.parts),
        activity_(size_t(tree.splats) * (tree.span + 1)),
        coded_(tree.span + 1),
        told_(tree.splats),
        which_(tree.splats) {}

  int32_t* residuals() { return residuals_.data(); }

  // Goes through the residuals of `knot`: code(first row, step, count, part, tables, flips) for every run; flips(i) says
  // whether the i-th residual's sign is turned, put(i, residual) takes it.
  template <typename Code>
  int32_t knot(const CagsKnot& knot, const Code& code) {
    uint8_t* activity = &activity_[size_t(tree_.splats) * knot.at];
    std::fill_n(activity, tree_.splats, uint8_t{0});
    const bool has_parent = knot.parent >= 0 && coded_[knot.parent];
    const uint8_t* parent = has_parent ? &activity_[size_t(tree_.splats) * knot.parent] : nullptr;
    for (int index = 0; index < int(std::size(kStrides)); index++) {
      const Group group(index, tree_.splats);
      tell(group, parent, activity);
      const int known = 2 * has_parent + 4 * (group.stride > 0);
      for (int part = tree_.turn; part < tree_.parts; part++) {
        choose(group, activity, known + part - tree_.turn);
        if (const int32_t status = code(group, part, which_.data())) return status;
        for (int i = 0, row = group.first; i < group.count; i++, row += group.step) {
          activity[row] = static_cast<uint8_t>(activity[row] + magnitude(residuals_[size_t(row) * tree_.parts + part]));
        }
      }
      if (tree_.turn) {
        choose_real(group, activity);
        if (const int32_t status = code(group, 0, which_.data())) return status;
      }
    }
    coded_[knot.at] = true;
    return CAGS_OK;
  }

  // Whether the neighbours' residuals of `part` add up to less than nothing.
  bool flips(const Group& group, int row, int part) const {
    if (group.stride == 0) return false;
    const int32_t* column = residuals_.data() + part;
    return int64_t{column[size_t(group.left(row)) * tree_.parts]} +
               column[size_t(group.right(row, tree_.splats)) * tree_.parts] < 0;
  }

 private:
  void tell(const Group& group, const uint8_t* parent, const uint8_t* activity) {
    for (int i = 0, row = group.first; i < group.count; i++, row += group.step) {
      int told = parent ? 2 * parent[row] : 0;
      if (group.stride > 0) told += 2 * (activity[group.left(row)] + activity[group.right(row, tree_.splats)]);
      told_[i] = static_cast<uint16_t>(told);
    }
  }

  void choose(const Group& group, const uint8_t* activity, int known) {
    const uint8_t* classes = tree_.classes + known * kSums;
    for (int i = 0, row = group.first; i < group.count; i++, row += group.step) {
      which_[i] = static_cast<uint8_t>(tree_.first_table + classes[told_[i] + 3 * activity[row]]);
    }
  }

  void choose_real(const Group& group, const uint8_t* activity) {
    for (int i = 0, row = group.first; i < group.count; i++, row += group.step) {
      const int a = activity[row];
      which_[i] = static_cast<uint8_t>(tree_.first_real_table + (a > 0) + (a > 2) + (a > 6));
    }
  }

  const CagsMotionTree& tree_;
  std::vector<int32_t> residuals_;
  std::vector<uint8_t> activity_;  // [span + 1, splats]
  std::vector<bool> coded_;
  std::vector<uint16_t> told_;
  std::vector<uint8_t> which_;
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

int32_t decode(const CagsMotionTree& tree, SymbolDecoder& decoder, Escapes& escapes, int32_t* samples) {
  Walk walk(tree);
  std::vector<uint8_t> symbols(tree.splats);
  const int64_t row_size = int64_t{tree.splats} * tree.parts;
  std::fill_n(samples, row_size * (tree.span + 1), 0);
  const int32_t tables = decoder.tables;
  auto code = [&](const Group& group, int part, const uint8_t* which) -> int32_t {
    if (std::any_of(which, which + group.count, [=](uint8_t table) { return table >= tables; })) return CAGS_SYMBOLS_TABLE;
    if (!decoder.take(group.count, which, symbols.data())) return CAGS_SYMBOLS_END;
    int32_t* out = walk.residuals() + part;
    for (int i = 0, row = group.first; i < group.count; i++, row += group.step) {
      int32_t value = symbols[i] >> 1 ^ -(symbols[i] & 1);
      if (symbols[i] == kEscape && !escapes.next(value)) return CAGS_ESCAPES_END;
      out[size_t(row) * tree.parts] = walk.flips(group, row, part) ? wrapped_negative(value) : value;
    }
    return CAGS_OK;
  };
  for (const CagsKnot* knot = tree.order; knot < tree.order + tree.knots; knot++) {
    if (const int32_t status = walk.knot(*knot, code)) return status;
    int32_t* sample = samples + knot->at * row_size;
    predict(*knot, row_size, samples, sample);
    for (int64_t i = 0; i < row_size; i++) sample[i] = wrapped_sum(sample[i], fixed(walk.residuals()[i]));
  }
  return CAGS_OK;
}

struct Quantiser {
  double to_units, threshold;

  int32_t operator()(double wanted, int32_t guess) const {
    const double off = wanted * to_units - guess * (1.0 / (1 << kFractionBits));
    const double size = std::fabs(off) + threshold;
    const int32_t whole = size < 0x1p30 ? static_cast<int32_t>(size) : 1 << 30;
    return off < 0 ? -whole : whole;
  }
};

struct Written {
  uint8_t *tables, *symbols;
  int32_t* escapes;
  int64_t count = 0, escape_count = 0;

  void put(uint8_t table, int32_t value) {
    const uint32_t folded = value < 0 ? 2u * static_cast<uint32_t>(-value) - 1 : 2u * static_cast<uint32_t>(value);
    tables[count] = table;
    symbols[count++] = static_cast<uint8_t>(std::min<uint32_t>(folded, kEscape));
    if (folded >= kEscape) escapes[escape_count++] = value;
  }
};

void encode(const CagsMotionTree& tree, double* left, int32_t unit, double deadzone, Written& out) {
  Walk walk(tree);
  const int64_t row_size = int64_t{tree.splats} * tree.parts, all = row_size * (tree.span + 1);
  std::vector<int32_t> samples(all);
  const Quantiser quantised{1.0 / unit, 0.5 - deadzone};
  auto code = [&](const Group& group, int part, const uint8_t* which) -> int32_t {
    const int32_t* residuals = walk.residuals() + part;
    for (int i = 0, row = group.first; i < group.count; i++, row += group.step) {
      const int32_t value = residuals[size_t(row) * tree.parts];
      out.put(which[i], walk.flips(group, row, part) ? -value : value);
    }
    return CAGS_OK;
  };
  for (const CagsKnot* knot = tree.order; knot < tree.order + tree.knots; knot++) {
    int32_t* sample = &samples[knot->at * row_size];
    predict(*knot, row_size, samples.data(), sample);
    const double* wanted = left + knot->at * row_size;
    for (int64_t i = 0; i < row_size; i++) {
      const int32_t residual = quantised(wanted[i], sample[i]);
      walk.residuals()[i] = residual;
      sample[i] = wrapped_sum(sample[i], fixed(residual));
    }
    walk.knot(*knot, code);
  }
  const double scale = unit * (1.0 / (1 << kFractionBits));
  for (int64_t i = 0; i < all; i++) left[i] -= samples[i] * scale;
}

}  // namespace
}  // namespace cags::motion

using namespace cags::motion;

int32_t cags_motion_decode_tree(const CagsMotionTree* tree, void* decoder, const uint8_t* escapes, int64_t escape_count,
                                int64_t* escape, int32_t* samples) {
  if (!valid(*tree) || escape_count < 0 || *escape < 0) return CAGS_INVALID;
  int32_t status = CAGS_OK;
  Escapes large{escapes, escape_count, *escape};
  const int32_t ran = cags::guarded([&] { status = decode(*tree, *static_cast<SymbolDecoder*>(decoder), large, samples); });
  *escape = large.at;
  return ran == CAGS_OK ? status : ran;
}

int32_t cags_motion_encode_tree(const CagsMotionTree* tree, double* left, int32_t unit, double deadzone, uint8_t* tables,
                                uint8_t* symbols, int32_t* escapes, int64_t* escape_count) {
  if (!valid(*tree) || unit < 1 || !std::has_single_bit(static_cast<uint32_t>(unit))) return CAGS_INVALID;
  Written out{tables, symbols, escapes};
  const int32_t ran = cags::guarded([&] { encode(*tree, left, unit, deadzone, out); });
  *escape_count = out.escape_count;
  return ran;
}
