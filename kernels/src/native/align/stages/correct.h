// The correction, brought to the client's view and weighed by how well the alignment fits there.
#pragma once
#include "align/stages/bilinear.h"
#include "align/stages/projection.h"

namespace cags::align {
namespace {

constexpr int kAtOnce = 8;  // pixels
static_assert(kRun % kAtOnce == 0 && kLineSlack >= kAtOnce);

// Mean colour of a block of `kSize` pixels a side, or of any size where that is 0. What ends where the picture does is not
// `inner`: no fourth lane follows its last pixel.
template <int kSize>
inline Four block_mean(const float* first, int64_t stride, int any_size, bool inner) {
  const int size = kSize ? kSize : any_size;
  Four mean = {};
  for (int i = 0; i < size; i++, first += stride) {
    for (int j = 0; j + 1 < size; j++) mean += colour_at(first + 3 * j, true);
    mean += colour_at(first + 3 * (size - 1), inner);
  }
  return mean * (1.0f / static_cast<float>(size * size));
}

using BlockMean = Four (*)(const float* first, int64_t stride, int size, bool inner);

// The sizes of a display of one to three times a reference of 400x300 at usual margins have code of their own.
inline BlockMean block_mean_of(int size) {
  constexpr BlockMean kSized[] = {block_mean<0>, block_mean<1>, block_mean<2>, block_mean<3>,
                                  block_mean<4>, block_mean<5>, block_mean<6>};
  return kSized[size < 7 ? size : 0];
}

inline float sum_of_squares(const Four& v) { return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]; }

// One block of mean colour `mean`; `own` and `field` are where its central pixel lies in the reference.
inline void compare_block(const Four& mean, const Four& own, const Four& field, float confidence, float* disagreement,
                          int64_t plane, Agreement& row) {
  const Four offset = __builtin_shufflevector(field, field, 1, 2, 3, 0);
  const Four away = confidence * (mean - own), change = confidence * (mean * field[0] + offset);
  for (int c = 0; c < 3; c++) disagreement[c * plane] = away[c];
  if (!(sum_of_squares(mean) + sum_of_squares(own) > kVoidPower)) return;
  for (int c = 0; c < 3; c++) row.away[c] += away[c];
  row.power += sum_of_squares(change), row.seen++;
}

void compare(const CagsCorrectInput& in, const Padded& fields, const Padded& own, int row, const Blocks& blocks,
             Agreement& agreement) {
  Projected p;
  const int size = blocks.size, middle = size / 2, line = row * size + middle;
  const int64_t plane = int64_t{blocks.width} * blocks.height, stride = 3 * int64_t{in.view.width};
  const BlockMean mean_of = block_mean_of(size);
  float* disagreement = blocks.disagreement + int64_t{row} * blocks.width;
  for (int c = 0; c < 3; c++) std::fill_n(disagreement + c * plane, blocks.width, 0.0f);
  for (int first = 0; first < blocks.width; first += kRun) {
    const int count = std::min(kRun, blocks.width - first);
    if (!project(in.view, line, first * size + middle, size, count, p)) continue;
    const Taps taps(fields, p, count);
    const float* confidence = in.confidence + int64_t{line} * in.view.width + first * size + middle;
    for (int i = 0; i < count; i++) {
      const float certain = confidence[i * size];
      if (!(certain > 0)) continue;
      const int column = first + i;
      const bool inner = row + 1 < blocks.height || column + 1 < blocks.width;
      const Four mean = mean_of(in.distorted + row * size * stride + 3 * column * size, stride, size, inner);
      compare_block(mean, bilinear(own, taps[i]), bilinear(fields, taps[i]), certain, disagreement + column, plane,
                    agreement);
    }
  }
}

// Adds the squared sums over kWindow x kWindow blocks of one colour's disagreement, `lines` those of the rows, to `wrong`.
// `down` is kAround wider on either side, where the outermost blocks hold on.
inline void add_wrong(const float* const* lines, int width, float* __restrict down, float* __restrict wrong) {
  float* __restrict inner = down + kAround;
  std::copy_n(lines[0], width, inner);
  for (int l = 1; l < kWindow; l++) {
    for (int i = 0; i < width; i++) inner[i] += lines[l][i];
  }
  std::fill_n(down, kAround, inner[0]);
  std::fill_n(inner + width, kAround, inner[width - 1]);
  for (int i = 0; i < width; i++) {
    float sum = down[i];
    for (int j = 1; j < kWindow; j++) sum += down[i + j];
    wrong[i] += sum * sum;
  }
}

// `share` of the correction that is not an error of the alignment. `line` [2 width + 2 kAround] is scratch.
void settle(const CagsCorrectInput& in, int row, float power, float share, const Blocks& blocks, float* line) {
  constexpr float kSquaredCount = static_cast<float>(kWindow * kWindow) * (kWindow * kWindow);
  const int width = blocks.width;
  float* wrong = line + width + 2 * kAround;
  std::fill_n(wrong, width, 0.0f);
  for (int c = 0; c < 3; c++) {
    const float* lines[kWindow];
    for (int i = 0; i < kWindow; i++) {
      const int y = c * blocks.height + std::clamp(row + i - kAround, 0, blocks.height - 1);
      lines[i] = blocks.disagreement + int64_t{y} * width;
    }
    add_wrong(lines, width, line, wrong);
  }
  float* __restrict weight = blocks.weight + int64_t{row} * width;
  for (int i = 0; i < width; i++) weight[i] = share * power / (power + in.misregistration * wrong[i] / kSquaredCount);
}

// Two pixels' colours, one in each half, changed by their fields.
inline Eight corrected(const Eight& colour, const Eight& field) {
  const Eight factor = __builtin_shufflevector(field, field, 0, 0, 0, 0, 4, 4, 4, 4);
  const Eight offset = __builtin_shufflevector(field, field, 1, 2, 3, 0, 5, 6, 7, 4);
  return clipped(colour + (colour * factor + offset));
}

// Pixels that are not in the reference have no confidence; the field's corner that they read is multiplied by it. Two go side
// by side; what follows the last pixels is not touched.
inline void correct_run(const Taps& taps, int count, const Padded& fields, const float* confidence, const float* distorted,
                        float* restored) {
  int i = 0;
  for (; i + 2 < count; i += 2) {
    const Eight field = bilinear(fields, taps[i], taps[i + 1]) * halves(confidence[i], confidence[i + 1]);
    const Eight shown = corrected(halves(four(distorted + 3 * i), four(distorted + 3 * i + 3)), field);
    std::memcpy(restored + 3 * i, &shown, sizeof(Four));
    std::memcpy(restored + 3 * i + 3, reinterpret_cast<const char*>(&shown) + sizeof(Four), sizeof(Four));
  }
  for (; i < count; i++) {
    const Eight field = bilinear(fields, taps[i], taps[i]) * confidence[i];
    const Four colour = colour_at(distorted + 3 * i, i + 1 < count);
    const Eight shown = corrected(halves(colour, colour), field);
    put(restored, i, count, __builtin_shufflevector(shown, shown, 0, 1, 2, 3));
  }
}

// Fewer than eight values, and zeros.
inline Eight eight_of(const float* values, int count) {
  Eight out = {};
  for (int i = 0; i < count; i++) out[i] = values[i];
  return out;
}

// Confidences of a run, times the blocks' weights between their centres. `line` are those of this row, see weights_at. The
// blocks that eight pixels lie between are among eight neighbours: they are looked up in a register.
inline void weigh_run(const float* line, const Blocks& blocks, int first, int count, const float* confidence, float* out) {
  const Eight step = {0, 1, 2, 3, 4, 5, 6, 7}, least = {}, most = least + static_cast<float>(blocks.width - 1);
  const float inverse = 1.0f / static_cast<float>(blocks.size);
  for (int i = 0; i < count; i += kAtOnce) {
    const Eight middle = (step + (static_cast<float>(first + i) + 0.5f)) * inverse - 0.5f;
    const Eight x = middle < least ? least : middle > most ? most : middle;
    const EightInts block = __builtin_convertvector(x, EightInts);
    const float* near_by = line + block[0];
    const Eight a = looked_up(near_by, block - block[0]), b = looked_up(near_by + 1, block - block[0]);
    const Eight weight = a + (b - a) * (x - __builtin_convertvector(block, Eight));
    const Eight known = i + kAtOnce <= count ? eight(confidence + i) : eight_of(confidence + i, count - i);
    const Eight weighed = known * weight;
    std::memcpy(out + i, &weighed, sizeof weighed);
  }
}

// The blocks' weights at the height of one row of pixels, and the last one's again for all that may be looked at beyond.
inline void weights_at(const Blocks& blocks, int row, float* __restrict line) {
  const float middle = (static_cast<float>(row) + 0.5f) / static_cast<float>(blocks.size) - 0.5f;
  const float y = std::clamp(middle, 0.0f, static_cast<float>(blocks.height - 1));
  const int above = static_cast<int>(y), below = std::min(above + 1, blocks.height - 1);
  const float* top = blocks.weight + int64_t{above} * blocks.width;
  const float* low = blocks.weight + int64_t{below} * blocks.width;
  const float share = y - static_cast<float>(above);
  for (int i = 0; i < blocks.width; i++) line[i] = top[i] + (low[i] - top[i]) * share;
  std::fill_n(line + blocks.width, kLineSlack, line[blocks.width - 1]);
}

void correct(const CagsCorrectInput& in, const Padded& fields, const Blocks& blocks, int row, float* line, float* restored) {
  Projected p;
  float weighed[kRun];
  if (blocks.width) weights_at(blocks, row, line);
  for (int first = 0; first < in.view.width; first += kRun) {
    const int count = std::min(kRun, in.view.width - first);
    const int64_t start = int64_t{row} * in.view.width + first;
    const float* distorted = in.distorted + 3 * start;
    if (!project(in.view, row, first, 1, count, p)) {  // no confidence
      for (int i = 0; i < 3 * count; i++) restored[3 * start + i] = clipped(distorted[i]);
      continue;
    }
    const float* confidence = in.confidence + start;
    if (blocks.width) {
      weigh_run(line, blocks, first, count, confidence, weighed);
      confidence = weighed;
    }
    correct_run(Taps(fields, p, count), count, fields, confidence, distorted, restored + 3 * start);
  }
}

}  // namespace
}  // namespace cags::align
