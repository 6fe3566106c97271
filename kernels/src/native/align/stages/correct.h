// The correction, brought to the client's view and weighed by how well the alignment fits there.
#pragma once
#include "align/stages/bilinear.h"
#include "align/stages/projection.h"

namespace cags::align {
namespace {

inline Four block_mean(const CagsCorrectInput& in, const Blocks& blocks, int row, int column) {
  const bool inner = row + 1 < blocks.height || column + 1 < blocks.width;  // does not end where the picture may
  Four mean = {};
  for (int i = 0; i < blocks.size; i++) {
    const int64_t first = (int64_t{row} * blocks.size + i) * in.view.width + column * blocks.size;
    const float* pixel = in.distorted + 3 * first;
    for (int j = 0; j + 1 < blocks.size; j++) mean += colour_at(pixel + 3 * j, true);
    mean += colour_at(pixel + 3 * (blocks.size - 1), inner);
  }
  return mean * (1.0f / static_cast<float>(blocks.size * blocks.size));
}

inline float sum_of_squares(const Four& v) { return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]; }

// One block of mean colour `mean`; `own` and `field` are where its central pixel lies in the reference.
inline void compare_block(const Four& mean, const Four& own, const Four& field, float confidence, float* disagreement,
                          float* power) {
  const Four offset = __builtin_shufflevector(field, field, 1, 2, 3, 0);
  const Four away = confidence * (mean - own), change = confidence * (mean * field[0] + offset);
  std::memcpy(disagreement, &away, sizeof away);
  *power = sum_of_squares(mean) + sum_of_squares(own) > kVoidPower ? sum_of_squares(change) : -1.0f;
}

void compare(const CagsCorrectInput& in, const Padded& fields, const Padded& own, int row, const Blocks& blocks) {
  Projected p;
  const int middle = blocks.size / 2, line = row * blocks.size + middle;
  for (int first = 0; first < blocks.width; first += kRun) {
    const int count = std::min(kRun, blocks.width - first);
    project(in.view, line, first * blocks.size + middle, blocks.size, count, p);
    const Taps taps(fields, p, count);
    const float* confidence = in.confidence + int64_t{line} * in.view.width + first * blocks.size + middle;
    for (int i = 0; i < count; i++) {
      const int64_t block = int64_t{row} * blocks.width + first + i;
      float* disagreement = blocks.disagreement + kColourLanes * block;
      blocks.power[block] = -1.0f;
      std::fill_n(disagreement, kColourLanes, 0.0f);
      const float certain = confidence[i * blocks.size];
      if (!(certain > 0)) continue;
      const Four mean = block_mean(in, blocks, row, first + i);
      compare_block(mean, bilinear(own, taps[i]), bilinear(fields, taps[i]), certain, disagreement, blocks.power + block);
    }
  }
}

// `share` of the correction that is not an error of the alignment.
void settle(const CagsCorrectInput& in, int row, float power, float share, const Blocks& blocks) {
  const float* lines[3];
  for (int i = 0; i < 3; i++) {
    lines[i] = blocks.disagreement + int64_t{std::clamp(row + i - 1, 0, blocks.height - 1)} * blocks.width * kColourLanes;
  }
  const auto down = [&](int column) {
    const int at = std::clamp(column, 0, blocks.width - 1) * kColourLanes;
    return four(lines[0] + at) + four(lines[1] + at) + four(lines[2] + at);
  };
  float* weight = blocks.weight + int64_t{row} * blocks.width;
  Four left = down(-1), middle = down(0);
  for (int column = 0; column < blocks.width; column++) {
    const Four right = down(column + 1);
    weight[column] = share * power / (power + in.misregistration * sum_of_squares(left + middle + right) / 81.0f);
    left = middle, middle = right;
  }
}

// Pixels that are not in the reference have no confidence; the field's corner that they read is multiplied by it.
inline void correct_run(const Taps& taps, int count, const Padded& fields, const float* confidence, const float* distorted,
                        float* restored) {
  const Four zero = {}, one = {1.0f, 1.0f, 1.0f, 1.0f};
  for (int i = 0; i < count; i++) {
    const Four field = bilinear(fields, taps[i]) * confidence[i];
    const Four factor = __builtin_shufflevector(field, field, 0, 0, 0, 0);
    const Four offset = __builtin_shufflevector(field, field, 1, 2, 3, 0);
    const Four colour = colour_at(distorted + 3 * i, i + 1 < count);
    Four shown = colour + (colour * factor + offset);
    shown = shown < zero ? zero : shown;
    shown = shown > one ? one : shown;
    put(restored, i, count, shown);
  }
}

// Confidences of a run, times the blocks' weights between their centres. `line` [blocks.width] are those of this row.
inline void weigh_run(const float* line, const Blocks& blocks, int first, int count, const float* confidence, float* out) {
  const float inverse = 1.0f / static_cast<float>(blocks.size);
  const int last = blocks.width - 1;
  for (int i = 0; i < count; i++) {
    const float middle = (static_cast<float>(first + i) + 0.5f) * inverse - 0.5f;
    const float x = std::min(std::max(middle, 0.0f), static_cast<float>(last));
    const int a = static_cast<int>(x), b = std::min(a + 1, last);
    out[i] = confidence[i] * (line[a] + (line[b] - line[a]) * (x - static_cast<float>(a)));
  }
}

// The blocks' weights at the height of one row of pixels.
inline void weights_at(const Blocks& blocks, int row, float* __restrict line) {
  const float middle = (static_cast<float>(row) + 0.5f) / static_cast<float>(blocks.size) - 0.5f;
  const float y = std::clamp(middle, 0.0f, static_cast<float>(blocks.height - 1));
  const int above = static_cast<int>(y), below = std::min(above + 1, blocks.height - 1);
  const float* top = blocks.weight + int64_t{above} * blocks.width;
  const float* low = blocks.weight + int64_t{below} * blocks.width;
  const float share = y - static_cast<float>(above);
  for (int i = 0; i < blocks.width; i++) line[i] = top[i] + (low[i] - top[i]) * share;
}

void correct(const CagsCorrectInput& in, const Padded& fields, const Blocks& blocks, int row, float* line, float* restored) {
  Projected p;
  float weighed[kRun];
  if (blocks.width) weights_at(blocks, row, line);
  for (int first = 0; first < in.view.width; first += kRun) {
    const int count = std::min(kRun, in.view.width - first);
    const int64_t start = int64_t{row} * in.view.width + first;
    project(in.view, row, first, 1, count, p);
    const float* confidence = in.confidence + start;
    if (blocks.width) {
      weigh_run(line, blocks, first, count, confidence, weighed);
      confidence = weighed;
    }
    correct_run(Taps(fields, p, count), count, fields, confidence, in.distorted + 3 * start, restored + 3 * start);
  }
}

}  // namespace
}  // namespace cags::align
