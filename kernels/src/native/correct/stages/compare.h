// What a picture says is lacking in the client's own view: see cags_common.correction.trust, which defines it.
#pragma once
#include "correct/stages/expand.h"

#include <algorithm>

namespace cags::correct {
namespace {

constexpr float kNear = 3 * kSide * kSide;  // values of a neighbourhood
constexpr float kLeastPower = 1e-9f, kLeastDetail = 1e-4f;

// Beyond the edge the pixels on its other side, the outermost not twice.
inline int mirrored(int at, int size) {
  const int most = size - 1;
  if (most == 0) return 0;
  const int turn = (at % (2 * most) + 2 * most) % (2 * most);
  return turn > most ? 2 * most - turn : turn;
}

inline float within(float colour) { return std::min(std::max(colour, 0.0f), 1.0f); }

double apart(const CagsLackInput& in, int row) {
  const int64_t first = 3 * int64_t{row} * in.width;
  Eight sums = {};
  for (int i = 0; i < 3 * in.width; i += 8) {
    const int count = std::min(8, 3 * in.width - i);
    const Eight d = clamped(some(in.coded + first + i, count), 0, 1) - clamped(some(in.own + first + i, count), 0, 1);
    sums += d * d;
  }
  return sum(sums);
}

// The planes of a row, and the sums of each over the seven pixels around every pixel.
void measure(const CagsLackInput& in, int row, const Near& near) {
  const int64_t first = 3 * int64_t{mirrored(row, in.height)} * in.width;
  const float *own = in.own + first, *coded = in.coded + first;
  float *planes = near.planes(row), *sums = near.sums(row);
  const size_t pitch = near.pitch;
  for (int x = 0; x < in.width; x++) {
    float oo = 0, oc = 0, dd = 0;
    for (int c = 0; c < 3; c++) {
      const float o = within(own[3 * x + c]), p = within(coded[3 * x + c]);
      planes[c * pitch + x] = o, planes[(3 + c) * pitch + x] = p;
      oo += o * o, oc += o * p, dd += (o - p) * (o - p);
    }
    planes[6 * pitch + x] = oo, planes[7 * pitch + x] = oc, planes[8 * pitch + x] = dd;
  }
  for (int k = 0; k < kMoments; k++) {
    const float* plane = planes + k * pitch;
    float* wide = near.wide;
    std::copy_n(plane, in.width, wide + kAround);
    for (int i = 0; i < kAround; i++) {
      wide[i] = plane[mirrored(i - kAround, in.width)];
      wide[kAround + in.width + i] = plane[mirrored(in.width + i, in.width)];
    }
    for (int x = 0; x < in.width; x += 8) {
      Eight total = load(wide + x);
      for (int i = 1; i < kSide; i++) total += load(wide + x + i);
      store(sums + k * pitch + x, total);
    }
  }
}

// The rows [begin, end) of what is lacking, `to` the first of them.
void compare(const CagsLackInput& in, float noise, int begin, int end, const Near& near, int16_t* to) {
  const float least = std::max(in.error, kLeastDetail);
  const size_t pitch = near.pitch;
  for (int row = begin - kAround; row < begin + kAround; row++) measure(in, row, near);
  for (int row = begin; row < end; row++, to += size_t(in.width + 1) * kTap) {
    measure(in, row + kAround, near);
    const float* here = near.planes(row);
    for (int x = 0; x < in.width; x += 8) {
      Eight m[kMoments];
      for (int k = 0; k < kMoments; k++) {
        m[k] = Eight{};
        for (int y = row - kAround; y <= row + kAround; y++) m[k] += load(near.sums(y) + k * pitch + x);
        m[k] *= 1.0f / kNear;
      }
      // m[0..5] are thirds of the means of the colours
      Eight spread = m[6], together = m[7];
      for (int c = 0; c < 3; c++) spread -= 3.0f * m[c] * m[c], together -= 3.0f * m[c] * m[3 + c];
      const Eight share = clamped(1.0f - noise / greater(m[8], all(kLeastPower)), 0, 1);
      const Eight kept = clamped((together + least) / greater(spread + least, all(kLeastPower)), 0, 1);
      Eight over[kLanes];
      for (int c = 0; c < 3; c++) over[c] = share * (load(here + (3 + c) * pitch + x) - kept * load(here + c * pitch + x));
      over[3] = share * (1.0f - kept);
      for (int i = 0; i < 8; i++) {
        for (int c = 0; c < kLanes; c++) near.layer[kLanes * (x + i) + c] = over[c][i];
      }
    }
    pack_layer(in.width, near.layer, to);
  }
}

}  // namespace
}  // namespace cags::correct
