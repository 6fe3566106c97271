// The C interface of the codec: packed layers of codes to splats; the readable definition is cags_common.tiles.dequantise.
#pragma once
#include "cags_kernels.h"

enum CagsRotation : int32_t { CAGS_ROTATION_QUATERNION = 0, CAGS_ROTATION_RODRIGUES = 1 };
enum CagsColumn : int32_t { CAGS_QUATS = 0, CAGS_LOG_SCALES, CAGS_LOGITS, CAGS_SH0, CAGS_SH_REST, CAGS_COLUMNS };

// How one attribute's codes are read. Tables have a row for every code that their bits can name.
struct CagsCodecAttribute {
  const uint8_t* layer_bits;  // [layers] bits of each fresh layer, 1 to 8, those nearest to the root first
  const float* table;         // [2^bits, dim]: rows of whole codes, or of their lowest below_bits bits
  const float* leaves;        // [2^leaf bits, dim]; null where the first tree is all there is
  const float* spreads;       // as leaves: the unit of the table's rows
  int32_t layers, dim, below_bits;
  int32_t column, offset;  // where the values go: a CagsColumn, and the first float of a row
  int64_t lengths[4];      // elements of the four arrays, in their order: codes that would reach beyond are refused
};

struct CagsCodecTile {
  int64_t count;
  const uint32_t* before;  // [attributes, count] codes so far; null: none
  const uint8_t* data;     // the fresh layers, attribute by attribute: ceil(count bits / 8) bytes each, low bits first
  int64_t before_length, data_bytes;
  int32_t attributes, rotation;
  int32_t strides[CAGS_COLUMNS];  // floats a row of each column
};

struct CagsCodecTargets {
  uint32_t* codes;               // [attributes, count]; may be the same memory as before
  float* columns[CAGS_COLUMNS];  // [count, stride]
  int64_t codes_length;
  int64_t column_lengths[CAGS_COLUMNS];
};

// Nothing is written where a length does not fit, or a code leads beyond a table (CAGS_INVALID).
CAGS_API int32_t cags_codec_dequantise(const CagsCodecTile* tile, const CagsCodecAttribute* attributes,
                                       const CagsCodecTargets* targets);
// means [count, 3] = float(origin + cells step), each product and sum rounded as a double; lengths in floats
CAGS_API int32_t cags_codec_positions(const float* cells, int64_t cells_length, const double* origin, double step, float* means,
                                      int64_t means_length);

enum CagsCodecDamage : int32_t { CAGS_CODEC_END = 16, CAGS_CODEC_LEFT = 18 };

// How one layer of an attribute's codes is coded; see cags_common.tiles.contexts.
struct CagsCodecSymbols {
  const uint8_t* prefixes;      // [count] codes without this layer, of prefix_bits bits; null for the lowest layer
  const int32_t* nearest;       // [count, 2] as cags_codec_nearest gives them
  const uint16_t* frequencies;  // [contexts, 2^bits], none zero; each row adds up to 4096
  int32_t bits, prefix_bits;    // prefix_bits: zero for the lowest layer
  int64_t lengths[3];           // elements of the three arrays
};

// nearest [count, 2]: of each splat in the order of its tile the two nearest ones whose codes come before; -1: none
CAGS_API int32_t cags_codec_nearest(const float* cells, int64_t cells_length, int32_t* nearest, int64_t nearest_length);
// codes [count], and the same packed, low bits first; CAGS_CODEC_END, CAGS_CODEC_LEFT: damaged data
CAGS_API int32_t cags_codec_decode(const CagsCodecSymbols* model, const uint8_t* data, int64_t bytes, int64_t lanes,
                                   uint8_t* codes, int64_t codes_length, uint8_t* packed, int64_t packed_length);
// Final states [lanes] and the first word_count of words [count]
CAGS_API int32_t cags_codec_encode(const CagsCodecSymbols* model, const uint8_t* codes, int64_t codes_length, int64_t lanes,
                                   uint32_t* states, int64_t states_length, uint16_t* words, int64_t words_length,
                                   int64_t* word_count);
