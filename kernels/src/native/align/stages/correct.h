// The correction, brought to the client's view and weighed by how well the alignment fits there.
#pragma once
#include "align/stages/bilinear.h"
#include "align/stages/projection.h"

namespace cags::align {
namespace {

// Bilinear sample of three lanes without a border, clipped to [0, 1] before it is mixed.
inline void sample_own(const CagsCorrectInput& in, float x, float y, float* out) {
  const int w = in.view.reference_width, h = in.view.reference_height;
  const float px = std::clamp(x - 0.5f, 0.0f, static_cast<float>(w - 1));
  const float py = std::clamp(y - 0.5f, 0.0f, static_cast<float>(h - 1));
  const int left = static_cast<int>(px), top = static_cast<int>(py);
  const int right = std::min(left + 1, w - 1), bottom = std::min(top + 1, h - 1);
  const float ax = px - static_cast<float>(left), ay = py - static_cast<float>(top);
  const auto tap = [&](int row, int column, int c) { return clipped(in.own[(int64_t{row} * w + column) * 3 + c]); };
  for (int c = 0; c < 3; c++) {
    const float a = tap(top, left, c) * (1 - ax) + tap(top, right, c) * ax;
    const float b = tap(bottom, left, c) * (1 - ax) + tap(bottom, right, c) * ax;
    out[c] = a * (1 - ay) + b * ay;
  }
}

inline void block_mean(const CagsCorrectInput& in, const Blocks& blocks, int row, int column, float* mean) {
  const float share = 1.0f / static_cast<float>(blocks.size * blocks.size);
  mean[0] = mean[1] = mean[2] = 0.0f;
  for (int i = 0; i < blocks.size; i++) {
    const float* pixel = in.distorted + ((int64_t{row} * blocks.size + i) * in.view.width + column * blocks.size) * 3;
    for (int j = 0; j < blocks.size; j++, pixel += 3) {
      for (int c = 0; c < 3; c++) mean[c] += pixel[c];
    }
  }
  for (int c = 0; c < 3; c++) mean[c] *= share;
}

// One block, whose central pixel lies at (x, y) in the reference and counts by `confidence`.
inline void compare_block(const CagsCorrectInput& in, const Padded& fields, float x, float y, float confidence,
                          const float* mean, float* disagreement, float* power) {
  float own[3], shown = 0.0f, sum = 0.0f;
  sample_own(in, x, y, own);
  const Four field = bilinear(fields, x, y);
  for (int c = 0; c < 3; c++) {
    const float change = confidence * (mean[c] * field[0] + field[1 + c]);
    disagreement[c] = confidence * (mean[c] - own[c]);
    shown += mean[c] * mean[c] + own[c] * own[c];
    sum += change * change;
  }
  *power = shown > kVoidPower ? sum : -1.0f;
}

void compare(const CagsCorrectInput& in, const Padded& fields, int row, const Blocks& blocks) {
  Projected p;
  const int middle = blocks.size / 2, line = row * blocks.size + middle;
  for (int first = 0; first < blocks.width; first += kRun) {
    const int count = std::min(kRun, blocks.width - first);
    project(in.view, line, first * blocks.size + middle, blocks.size, count, p);
    for (int i = 0; i < count; i++) {
      const int column = first + i;
      const int64_t block = int64_t{row} * blocks.width + column;
      const float confidence = in.confidence[int64_t{line} * in.view.width + column * blocks.size + middle];
      float* disagreement = blocks.disagreement + 3 * block;
      blocks.power[block] = -1.0f;
      disagreement[0] = disagreement[1] = disagreement[2] = 0.0f;
      if (!(confidence > 0)) continue;
      float mean[3];
      block_mean(in, blocks, row, column, mean);
      compare_block(in, fields, p.x[i], p.y[i], confidence, mean, disagreement, blocks.power + block);
    }
  }
}

void settle(const CagsCorrectInput& in, int row, float power, const Blocks& blocks) {
  for (int column = 0; column < blocks.width; column++) {
    float sum[3] = {};
    for (int i = -1; i <= 1; i++) {
      const int y = std::clamp(row + i, 0, blocks.height - 1);
      for (int j = -1; j <= 1; j++) {
        const int x = std::clamp(column + j, 0, blocks.width - 1);
        for (int c = 0; c < 3; c++) sum[c] += blocks.disagreement[(int64_t{y} * blocks.width + x) * 3 + c];
      }
    }
    const float square = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]) / 81.0f;
    blocks.weight[int64_t{row} * blocks.width + column] = power / (power + in.misregistration * square);
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
