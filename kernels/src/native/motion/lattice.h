// The order in which the splats of a knot are coded: groups of halved strides, each between those that came before.
#pragma once
#include <algorithm>
#include <vector>

namespace cags::motion {

inline constexpr int kStrides[] = {32, 16, 8, 4, 2, 1};

// Splats that are coded together: `first`, `first + step`, ...; those after the first group have neighbours.
struct Group {
  int first, step, count;
  bool between;  // neighbours

  Group(int index, int splats) : between(index > 0) {
    first = between ? kStrides[index] : 0, step = between ? 2 * kStrides[index] : kStrides[0];
    count = splats > first ? (splats - first + step - 1) / step : 0;
  }
};

// Numbers of the splats of all groups so far, in the splats' order: those of the next group come between them.
template <typename Number>
class Lattice {
 public:
  explicit Lattice(int splats) : now_(splats + 2), next_(splats + 2), fresh_(splats + 1) {}
  void clear() { count_ = 0; }
  const Number* left() const { return now_.data(); }  // of the i-th of a group: [i], and to its right [i + 1]
  Number* fresh() { return fresh_.data(); }           // the group's own

  void merge(const Group& group) {
    if (!group.between) {
      std::copy_n(fresh_.data(), group.count, now_.data());
    } else {
      const Number* __restrict old = now_.data(), * __restrict fresh = fresh_.data();
      Number* __restrict to = next_.data();
      const int count = group.count;
      for (int i = 0; i < count; i++) to[2 * i] = old[i], to[2 * i + 1] = fresh[i];
      if (count_ > group.count) to[2 * group.count] = old[group.count];
      now_.swap(next_);
    }
    count_ += group.count;
    now_[count_] = count_ ? now_[count_ - 1] : Number{};  // the last has the same neighbour twice
  }

 private:
  std::vector<Number> now_, next_, fresh_;
  int count_ = 0;
};

}  // namespace cags::motion
