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

enum CagsMotionLimits : int32_t { CAGS_MAX_SPAN = 64, CAGS_MAX_TILE_SPLATS = 1 << 16, CAGS_NEIGHBOURS = 8, CAGS_FIT = 8 };
enum CagsKnotKind : int32_t { CAGS_KNOT_START = 0, CAGS_KNOT_END = 1, CAGS_KNOT_MIDDLE = 2 };

struct CagsKnot {
  int32_t kind, at, left, right, parent;  // samples; parent -1: none
  int32_t before, after;                  // samples beyond left and right that a curve goes through; -1: none
  int32_t weight_before, weight_after;    // in 1/4096, of what these are off the line through left and right
};

// How the residuals of one level are laid out, coded and told apart.
struct CagsMotionTree {
  int32_t span, splats;
  int32_t parts, turn;  // 3 and 0, or 4 and 1
  int32_t knots;
  int32_t first_table, first_real_table;
  int32_t silent_table;       // of the flags whether a knot has no residuals
  int32_t unit;               // finest units a unit of the residuals, a power of two
  const CagsKnot* order;      // [knots]
  const uint8_t* classes;     // [8, 1324] of a residual, by what is known and what it tells
  const int32_t* neighbours;  // [splats, 8] of each splat, which come before it
  const float* fits;          // [splats, 8, 8] of each: share, place (3), what it adds to the slopes (3), to the level
  const float* units;         // [splats] of the residuals, in parts of the largest
  int64_t lengths[4];         // elements of the last four, in their order
};

// One tile at a time. Null pointers leave that part of the motion out.
struct CagsMotionTile {
  int32_t splats, span, sample;
  double time, share;
  const int32_t* rows;      // [splats] of the arrays by id; -1: left out
  const int32_t* moves;     // [span + 1, splats, 3]
  const int32_t* turns;     // [span + 1, splats, 4]
  const float* move_steps;  // [splats]
  const float* turn_steps;  // [splats]
  const uint8_t* lives;     // [splats]
  const float* fades;       // [splats, 2] centre and standard deviation in frames; infinite: none
  int64_t lengths[7];       // elements of the seven, in their order: what does not fit is refused
};

struct CagsMotionArrays {  // by id
  int64_t capacity;
  const float *means, *quats, *logits;
  float *into_means, *into_quats, *into_logits;
  int64_t lengths[6];  // floats in each of the six, in their order
};

// What is coded, and where it goes.
struct CagsSymbolsEncoding {
  const uint8_t *tables, *symbols;       // [count]
  const int64_t* run_lengths;            // which together are the count
  const uint32_t *frequencies, *firsts;  // [tables, 256]; frequencies of what occurs are above 0
  uint32_t* states;                      // [lanes]
  uint16_t* words;                       // [count], of which the last are written
  int64_t lengths[7];                    // elements of the seven, in their order
};

// What the samples are to come closer to, and where it goes.
struct CagsTreeEncoding {
  const double* wanted;       // [span + 1, splats, parts] in finest units, every value within 2^26
  int32_t* samples;           // of that shape, in 1/64 of the finest unit: as told so far
  uint8_t* told;              // of that shape: not 0 where a coarser level had a residual, becomes 1 where this one has
  uint8_t *tables, *symbols;  // [knots (1 + splats parts)] at most
  int32_t* escapes;           // [knots splats parts] at most
  int64_t lengths[6];         // elements of the six, in their order
  double deadzone;
};

// All lengths are in elements; where one does not fit the answer is CAGS_INVALID, and nothing is written.

// counts [64, 256]: how often each table codes each symbol; CAGS_INVALID for a table beyond
CAGS_API int32_t cags_symbols_count(const uint8_t* tables, int64_t tables_length, const uint8_t* symbols, int64_t symbols_length,
                                    int64_t* counts, int64_t counts_length);
CAGS_API int32_t cags_symbols_encode(const CagsSymbolsEncoding* given, int64_t* word_count);

// A decoder is memory of the caller's, 8-byte aligned; `data` has to live as long.
CAGS_API int64_t cags_symbols_decoder_bytes();
CAGS_API int32_t cags_symbols_open(const uint8_t* data, int64_t bytes, void* decoder, int64_t decoder_bytes);
CAGS_API int32_t cags_symbols_take(void* decoder, const uint8_t* tables, int64_t tables_length, uint8_t* symbols,
                                   int64_t symbols_length);
CAGS_API int32_t cags_symbols_finish(const void* decoder);

// Of splats at positions [splats, 3], of units [splats]: neighbours [splats, 8] and fits [splats, 8, 8]; CAGS_INVALID
// for what is not finite
CAGS_API int32_t cags_motion_neighbours(const float* positions, int64_t positions_length, const float* units,
                                        int64_t units_length, int32_t* neighbours, int64_t neighbours_length, float* fits,
                                        int64_t fits_length);

// samples [span + 1, splats, parts], in 1/64 of the finest unit, are taken on by the level; *escape is the next of the
// escapes, little-endian and of any alignment; told, of the samples' shape: not 0 where a coarser level had a residual,
// becomes 1 where this one has
CAGS_API int32_t cags_motion_decode_tree(const CagsMotionTree* tree, void* decoder, const uint8_t* escapes,
                                         int64_t escapes_length, int64_t* escape, uint8_t* told, int64_t told_length,
                                         int32_t* samples, int64_t samples_length);
// written [2]: how many symbols, and how many escapes
CAGS_API int32_t cags_motion_encode_tree(const CagsMotionTree* tree, const CagsTreeEncoding* given, int64_t* written);

CAGS_API int32_t cags_motion_rows(const CagsMotionTile* tiles, int32_t count, const CagsMotionArrays* arrays, int32_t threads);
