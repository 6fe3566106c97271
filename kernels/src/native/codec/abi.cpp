// Plain single-precision arithmetic in the order of the numpy definition, so that both give the same bits. Words of codes
// are read as little-endian, as every processor does that this library is built for.
#include "codec/cags_codec.h"
#include "codec/unpack.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace cags::codec {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr int kBlock = 512;  // splats at a time: codes and values stay in the first-level cache
static_assert(kBlock % kGroup == 0, "blocks begin at whole bytes of every layer");
constexpr float kNoDirection = 1e-12f;
constexpr int kMostFreshBits = 30;
constexpr int64_t kMostSplats = std::numeric_limits<int32_t>::max();  // so that no product of sizes overflows

int64_t packed_bytes(int64_t count, int bits) { return (count * bits + 7) / 8; }

void look_up(const CagsCodecAttribute& a, const uint32_t* codes, int count, float* out, int stride) {
  const int dim = a.dim;
  if (!a.leaves) {
    for (int i = 0; i < count; i++, out += stride) {
      const float* row = a.table + size_t(codes[i]) * dim;
      for (int d = 0; d < dim; d++) out[d] = row[d];
    }
    return;
  }
  const uint32_t mask = (1u << a.below_bits) - 1;
  for (int i = 0; i < count; i++, out += stride) {
    const size_t leaf = size_t(codes[i] >> a.below_bits) * dim;
    const float* row = a.table + size_t(codes[i] & mask) * dim;
    for (int d = 0; d < dim; d++) out[d] = row[d] * a.spreads[leaf + d] + a.leaves[leaf + d];
  }
}

// Modified Rodrigues parameters in the last three floats of each row; beyond length 1 they turn by more than 180 degrees.
void from_rodrigues(float* quats, int count) {
  for (float* q = quats; q < quats + 4 * count; q += 4) {
    const float square = q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    const float shrink = (square > 1.0f ? -1.0f : 1.0f) / (1.0f + square), twice = 2.0f * shrink;
    q[0] = (1.0f - square) * shrink;
    for (int i = 1; i < 4; i++) q[i] *= twice;
  }
}

void normalise(float* quats, int count) {
  for (float* q = quats; q < quats + 4 * count; q += 4) {
    const float norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    const float scale = (q[0] < 0.0f ? -1.0f : 1.0f) / norm;
    if (norm < kNoDirection) {
      q[0] = 1.0f, q[1] = q[2] = q[3] = 0.0f;
    } else {
      for (int i = 0; i < 4; i++) q[i] *= scale;
    }
  }
}

// Bits of the fresh layers together; negative where one cannot be read.
int fresh_bits(const CagsCodecAttribute& at) {
  if (at.layers < 0 || at.lengths[0] != at.layers) return -1;
  int sum = 0;
  for (int layer = 0; layer < at.layers; layer++) {
    const int bits = at.layer_bits[layer];
    if (bits < 1 || bits > kMostBits || sum + bits > kMostFreshBits) return -1;
    sum += bits;
  }
  return sum;
}

// Whether the tables have a row for each of the `codes` codes that their bits can name.
bool reached(const CagsCodecAttribute& at, int64_t codes) {
  const int64_t rows = at.lengths[1] / at.dim;
  if (!at.leaves) return !at.spreads && at.lengths[2] == 0 && at.lengths[3] == 0 && codes <= rows;
  const int64_t below = int64_t{1} << at.below_bits, leaves = (codes + below - 1) / below;
  return at.spreads && at.lengths[3] == at.lengths[2] && below <= rows && leaves <= at.lengths[2] / at.dim;
}

bool fits(const CagsCodecTile& tile, const CagsCodecAttribute& at, const uint32_t* before) {
  if (at.column < 0 || at.column >= CAGS_COLUMNS || at.below_bits < 0 || at.below_bits > 16 || at.dim < 1) return false;
  if (at.offset < 0 || int64_t{at.offset} + at.dim > tile.strides[at.column]) return false;
  const int fresh = fresh_bits(at);
  if (fresh < 0) return false;
  uint32_t bits = 0;  // that any of the codes has: unlike the greatest, every processor finds them in vectors
  for (int64_t i = 0, count = before ? tile.count : 0; i < count; i++) bits |= before[i];
  return reached(at, int64_t{1} << (std::bit_width(bits) + fresh));
}

bool valid(const CagsCodecTile& tile, const CagsCodecAttribute* attributes, const CagsCodecTargets& targets) {
  if (tile.count < 0 || tile.count > kMostSplats || tile.attributes < 1 || tile.strides[CAGS_QUATS] != 4) return false;
  const int64_t codes = tile.attributes * tile.count;
  if (targets.codes_length != codes || tile.before_length != (tile.before ? codes : 0)) return false;
  for (int column = 0; column < CAGS_COLUMNS; column++) {
    if (tile.strides[column] < 0 || targets.column_lengths[column] != tile.strides[column] * tile.count) return false;
  }
  int64_t bytes = 0;
  for (int a = 0; a < tile.attributes; a++) {
    if (!fits(tile, attributes[a], tile.before ? tile.before + a * tile.count : nullptr)) return false;
    for (int layer = 0; layer < attributes[a].layers; layer++) bytes += packed_bytes(tile.count, attributes[a].layer_bits[layer]);
  }
  return bytes == tile.data_bytes;
}

// One attribute of one block. Returns where the data of the next attribute begins.
const uint8_t* decode(const CagsCodecTile& tile, const CagsCodecAttribute& a, const CagsCodecTargets& targets, int index,
                      int64_t first, int count, const uint8_t* data) {
  const int64_t at = index * tile.count + first;
  uint32_t* codes = targets.codes + at;
  if (!tile.before) {
    std::fill_n(codes, count, 0u);
  } else if (tile.before + at != codes) {
    std::copy_n(tile.before + at, count, codes);
  }
  for (int layer = 0; layer < a.layers; layer++) {
    const int bits = a.layer_bits[layer];
    kAppend[bits](data + first * bits / 8, count, codes);
    data += packed_bytes(tile.count, bits);
  }
  const int stride = tile.strides[a.column];
  look_up(a, codes, count, targets.columns[a.column] + first * stride + a.offset, stride);
  return data;
}

void dequantise(const CagsCodecTile& tile, const CagsCodecAttribute* attributes, const CagsCodecTargets& targets) {
  for (int64_t first = 0; first < tile.count; first += kBlock) {
    const int count = static_cast<int>(std::min<int64_t>(kBlock, tile.count - first));
    const uint8_t* data = tile.data;
    for (int a = 0; a < tile.attributes; a++) data = decode(tile, attributes[a], targets, a, first, count, data);
    float* quats = targets.columns[CAGS_QUATS] + 4 * first;
    tile.rotation == CAGS_ROTATION_RODRIGUES ? from_rodrigues(quats, count) : normalise(quats, count);
  }
}

}  // namespace
}  // namespace cags::codec

int32_t cags_codec_dequantise(const CagsCodecTile* tile, const CagsCodecAttribute* attributes, const CagsCodecTargets* targets) {
  using namespace cags::codec;
  if (!valid(*tile, attributes, *targets)) return CAGS_INVALID;
  dequantise(*tile, attributes, *targets);
  return CAGS_OK;
}

int32_t cags_codec_positions(const float* cells, int64_t cells_length, const double* origin, double step, float* means,
                             int64_t means_length) {
  if (cells_length < 0 || cells_length % 3 || means_length != cells_length) return CAGS_INVALID;
  for (int64_t i = 0; i < cells_length; i += 3) {
    for (int axis = 0; axis < 3; axis++) means[i + axis] = static_cast<float>(origin[axis] + double{cells[i + axis]} * step);
  }
  return CAGS_OK;
}
