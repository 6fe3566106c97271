#include "align/erode.h"

#include "align/calls.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cstdlib>
#include <cstring>
#include <utility>
#include <vector>

namespace cags::align {
namespace {

typedef float Four __attribute__((vector_size(16), aligned(4), may_alias));
typedef int32_t Mask __attribute__((vector_size(16)));

constexpr uint8_t kHeld = 1, kNear = 2;  // marks of words: within a row's holes' reach; within another row's

// A bit a pixel, inside a border of words and rows of zeros that windows may read.
class Bits {
 public:
  Bits(const Erosion& how, uint64_t* memory) : memory_(memory), stride_(stride(how)), border_(how.radius) {}

  static int words(const Erosion& how) { return (how.width + kWord - 1) / kWord; }
  static int stride(const Erosion& how) { return words(how) + 2; }
  static size_t size(const Erosion& how) { return size_t(stride(how)) * (how.height + 2 * how.radius); }

  uint64_t* row(int y) const { return memory_ + int64_t{y + border_} * stride_ + 1; }  // y in [-radius, height + radius)

 private:
  uint64_t* memory_;
  int stride_, border_;
};

// The bits within `radius` of one in the middle of three neighbouring words, the middle word's part.
uint64_t spread(uint64_t before, uint64_t middle, uint64_t after, int radius) {
  uint64_t out = middle;
  for (int i = 1; i <= radius; i++) out |= (middle << i | before >> (kWord - i)) | (middle >> i | after << (kWord - i));
  return out;
}

class Eroder {
 public:
  Eroder(const Erosion& how, AlignedArray<uint64_t>& memory, float* rgb)
      : how_(how),
        pieces_((how.height + kRowsAPiece - 1) / kRowsAPiece),
        words_(Bits::words(how)),
        holes_(how, memory.reserve(3 * Bits::size(how))),
        ready_(how, holes_.row(-how.radius) - 1 + Bits::size(how)),
        next_(how, ready_.row(-how.radius) - 1 + Bits::size(how)),
        held_(pieces_),
        rgb_(rgb) {
    std::fill_n(memory.reserve(3 * Bits::size(how)), 3 * Bits::size(how), uint64_t{0});
  }

  // Finds the holes. False where there are none.
  bool find(const uint8_t* occluded) {
    each_piece([&](int piece) {
      for (int y = piece * kRowsAPiece; y < bottom(piece); y++) {
        for (int word = 0; word < words_; word++) {
          const uint8_t* bytes = occluded + int64_t{y} * how_.width + word * kWord;
          const uint64_t holes = word_of(bytes, std::min(kWord, how_.width - word * kWord));
          if (!holes) continue;
          holes_.row(y)[word] = holes;
          held_[piece].push_back({y, word});
        }
      }
    });
    return std::any_of(held_.begin(), held_.end(), [](const auto& places) { return !places.empty(); });
  }

  // Asks for what is clean around the holes.
  void look_around(const CleanWord& clean) {
    const std::vector<uint8_t> asked = reached();
    each_piece([&](int piece) {
      for (int y = piece * kRowsAPiece; y < bottom(piece); y++) {
        for (int word = 0; word < words_; word++) {
          if (asked[size_t(y) * words_ + word]) ready_.row(y)[word] = next_.row(y)[word] = clean(y, word);
        }
      }
    });
  }

  void fill_rings() {
    for (int ring = 0; ring < how_.iterations; ring++) {
      std::atomic<bool> any = false;
      each_piece([&](int piece) {
        uint64_t filled = 0;
        for (const Place& place : held_[piece]) filled |= fill_word(place);
        if (filled) any.store(true, std::memory_order_relaxed);
      });
      if (!any) return;
      std::swap(ready_, next_);
    }
  }

 private:
  struct Place {
    int row, word;
  };

  template <typename Body>
  void each_piece(const Body& body) {
    parallel_for(how_.threads, pieces_, [&](int piece, int) { body(piece); });
  }

  int bottom(int piece) const { return std::min((piece + 1) * kRowsAPiece, how_.height); }

  // [height, words]: not 0 where the window of a hole reads.
  std::vector<uint8_t> reached() const {
    const int reach = how_.radius;
    std::vector<uint8_t> out(size_t(how_.height) * words_);
    for (const auto& places : held_) {
      for (const Place& place : places) mark_row(place, reach, out.data() + size_t(place.row) * words_);
    }
    for (int word = 0; word < words_; word++) {
      int above = -reach - 1, below = how_.height + reach;  // the nearest row that a hole marked
      for (int y = 0; y < how_.height; y++) mark_column(out[size_t(y) * words_ + word], y, reach, above);
      for (int y = how_.height - 1; y >= 0; y--) mark_column(out[size_t(y) * words_ + word], y, reach, below);
    }
    return out;
  }

  // Marks the words of a hole's row that lie within `reach` of one of its word's holes.
  void mark_row(const Place& place, int reach, uint8_t* marks) const {
    const uint64_t holes = holes_.row(place.row)[place.word];
    marks[place.word] = kHeld;
    if (place.word > 0 && holes << (kWord - reach)) marks[place.word - 1] = kHeld;
    if (place.word + 1 < words_ && holes >> (kWord - reach)) marks[place.word + 1] = kHeld;
  }

  static void mark_column(uint8_t& mark, int y, int reach, int& last) {
    if (mark == kHeld) {
      last = y;
    } else if (std::abs(y - last) <= reach) {
      mark = kNear;
    }
  }

  // Fills the holes of a word that have ready neighbours. `next_` is what the ring to come reads.
  uint64_t fill_word(const Place& place) {
    uint64_t around[3] = {};
    for (int y = place.row - how_.radius; y <= place.row + how_.radius; y++) {
      const uint64_t* row = ready_.row(y) + place.word;
      for (int i = 0; i < 3; i++) around[i] |= row[i - 1];
    }
    const uint64_t ready = ready_.row(place.row)[place.word];
    const uint64_t filled = spread(around[0], around[1], around[2], how_.radius) & holes_.row(place.row)[place.word] & ~ready;
    if (filled) fill(place, filled);
    next_.row(place.row)[place.word] = ready | filled;
    return filled;
  }

  // Sums down the columns first, which neighbouring windows share.
  void fill(const Place& place, uint64_t filled) {
    const int radius = how_.radius, first = place.word * kWord;
    Four sums[kWord + 2 * kMaxErosion];  // of columns first - radius, ...
    int done = 0;
    for (uint64_t left = filled; left; left &= left - 1) {
      const int column = std::countr_zero(left);
      for (done = std::max(done, column); done <= column + 2 * radius; done++) {
        sums[done] = column_sum(place.row, first + done - radius);
      }
      Four sum = sums[column];
      for (int i = 1; i <= 2 * radius; i++) sum += sums[column + i];
      const Four mean = sum / sum[3];
      std::memcpy(rgb_ + 3 * (int64_t{place.row} * how_.width + first + column), &mean, 3 * sizeof(float));
    }
  }

  // Colours that are ready within the radius above and below, added, and how many they are.
  Four column_sum(int row, int column) const {
    static const Mask kColour[2] = {{0, 0, 0, 0}, {-1, -1, -1, 0}};
    static const Four kOne[2] = {{0, 0, 0, 0}, {0, 0, 0, 1}};
    const int word = (column + kWord) / kWord - 1, shift = (column + kWord) % kWord;
    const int top = std::max(row - how_.radius, 0), bottom = std::min(row + how_.radius, how_.height - 1);
    Four sum = {};
    for (int y = top; y <= bottom; y++) {
      const int ready = static_cast<int>(ready_.row(y)[word] >> shift & 1);
      const int64_t pixel = ready ? int64_t{y} * how_.width + column : 0;
      sum += reinterpret_cast<Four>(reinterpret_cast<Mask>(colour(pixel)) & kColour[ready]) + kOne[ready];
    }
    return sum;
  }

  Four colour(int64_t pixel) const {  // the fourth lane is the next pixel's, which the last one does not have
    const float* at = rgb_ + 3 * pixel;
    const bool last = pixel + 1 == int64_t{how_.width} * how_.height;
    return last ? Four{at[0], at[1], at[2], 0.0f} : *reinterpret_cast<const Four*>(at);
  }

  const Erosion& how_;
  int pieces_, words_;
  Bits holes_, ready_, next_;
  std::vector<std::vector<Place>> held_;
  float* rgb_;
};

}  // namespace

void erode(const Erosion& how, const uint8_t* occluded, const CleanWord& clean, AlignedArray<uint64_t>& memory, float* rgb) {
  Eroder eroder(how, memory, rgb);
  if (!eroder.find(occluded)) return;
  eroder.look_around(clean);
  eroder.fill_rings();
}

}  // namespace cags::align
