// The C interface of motion: entropy coding, trees of residuals, and tiles at a time. The readable definitions are
// cags_common.coding.rans and cags_common.motion; every function gives the same bits.
#pragma once
#include "cags_kernels.h"

// Statuses beside CagsStatus: what damaged data comes to.
enum CagsMotionStatus : int32_t {
  CAGS_SYMBOLS_END = 16,      // they end too early
  CAGS_SYMBOLS_TABLE = 17,    // a table that the data does not have
  CAGS_SYMBOLS_LEFT = 18,     // the data does not end where they do
  CAGS_SYMBOLS_DAMAGED = 19,  // header or tables
  CAGS_ESCAPES_END = 20,      // large residuals are missing
};

enum CagsKnotKind : int32_t { CAGS_KNOT_START = 0, CAGS_KNOT_END = 1, CAGS_KNOT_MIDDLE = 2 };

struct CagsKnot {
  int32_t kind, at, left, right, parent;  // samples; parent -1: none
};

// How the residuals of one level are laid out, coded and told apart.
struct CagsMotionTree {
  int32_t span, splats;
  int32_t parts, turn;  // 3 and 0, or 4 and 1
  int32_t knots;
  int32_t first_table, first_real_table;
  const CagsKnot* order;   // [knots]
  const uint8_t* classes;  // [9, 1513] of a residual, by what is known and what it tells
};

// One tile at a time. Null pointers leave that part of the motion out.
struct CagsMotionTile {
  int32_t splats, span, sample;
  int32_t block;  // splats a block
  int32_t fades;  // not 0: opacities are left alone
  int32_t reserved;
  double time, share, block_unit;
  const int32_t* rows;          // [splats] of the arrays by id; -1: left out
  const int32_t* moves;         // [span + 1, splats, 3]
  const int32_t* turns;         // [span + 1, splats, 4]
  const float* move_steps;      // [splats]
  const float* turn_steps;      // [splats]
  const int32_t* block_shifts;  // [span + 1, blocks, 3]
  const int32_t* block_turns;   // [span + 1, blocks, 3]
  const uint8_t* lives;         // [splats]
};

struct CagsMotionArrays {  // by id
  int64_t capacity;
  const float *means, *quats, *logits;
  float *into_means, *into_quats, *into_logits;
};

// counts [64, 256]: how often each table codes each symbol; CAGS_INVALID for a table beyond
CAGS_API int32_t cags_symbols_count(int64_t count, const uint8_t* tables, const uint8_t* symbols, int64_t* counts);
// frequencies and firsts [tables, 256], those of what occurs above 0; states [lanes]; words [count], of which the last
// *word_count are written
CAGS_API int32_t cags_symbols_encode(int64_t count, const uint8_t* tables, const uint8_t* symbols, int64_t runs,
                                     const int64_t* run_lengths, int32_t lanes, const uint32_t* frequencies,
                                     const uint32_t* firsts, uint32_t* states, uint16_t* words, int64_t* word_count);

// A decoder is memory of the caller's, 8-byte aligned; `data` has to live as long.
CAGS_API int64_t cags_symbols_decoder_bytes();
CAGS_API int32_t cags_symbols_open(const uint8_t* data, int64_t bytes, void* decoder);
CAGS_API int32_t cags_symbols_take(void* decoder, int64_t count, const uint8_t* tables, uint8_t* symbols);
CAGS_API int32_t cags_symbols_finish(const void* decoder);

// samples [span + 1, splats, parts]; *escape is the next of escapes [escape_count], little-endian and of any alignment;
// told, of the samples' shape: not 0 where a coarser level had a residual, becomes 1 where this one has
CAGS_API int32_t cags_motion_decode_tree(const CagsMotionTree* tree, void* decoder, const uint8_t* escapes, int64_t escape_count,
                                         int64_t* escape, uint8_t* told, int32_t* samples);
// left [span + 1, splats, parts], every value within 2^26: what was said is taken off; told as above; tables and symbols
// [knots splats parts]; escapes as many at most, *escape_count of them
CAGS_API int32_t cags_motion_encode_tree(const CagsMotionTree* tree, double* left, uint8_t* told, int32_t unit, double deadzone,
                                         uint8_t* tables, uint8_t* symbols, int32_t* escapes, int64_t* escape_count);

CAGS_API int32_t cags_motion_rows(const CagsMotionTile* tiles, int32_t count, const CagsMotionArrays* arrays, int32_t threads);
