/* The excitation of the rig's own motor: one period of a multisine as a table, worked out before anything moves.
 *
 * A tick looks one number up, so that a hundred lines cost what one costs. The table is in the board's memory:
 * int16_t for each tick of a period, quanta * 2^bits. All arithmetic is in integers, so that a host knows the table
 * to the bit (rig.control.excitation_table), and it repeats exactly. */
#ifndef LAW_EXCITATION_H
#define LAW_EXCITATION_H

#include <stdbool.h>
#include <stdint.h>

#include "law.h"

enum { LAW_COSINE_BITS = 24 };

/* A table that is being worked out; law_excitation_begin fills it in. Phases are in 2^-32 turns, their rests in
 * 2^-32 turns / period: so no phase drifts. */
typedef struct {
    law_excitation p;
    int16_t *table;
    uint32_t tick, line;        /* what comes next */
    uint32_t first, first_rest; /* phase of the first line at this tick, without its phase at tick 0 */
    uint32_t step, step_rest;   /* from a line to the next, at this tick */
    uint32_t first_turn, first_turn_rest, step_turn, step_turn_rest; /* what a tick adds to each */
    uint32_t share;             /* 2^32 / lines, for Schroeder's phases */
    int64_t sum;                /* of the lines before this one: cosines * 2^LAW_COSINE_BITS */
} law_excitation_work;

/* Begin a table of p->period numbers, for parameters that law_check has accepted. Without lines the table is complete
 * at once. */
void law_excitation_begin(law_excitation_work *w, const law_excitation *p, int16_t *table);

/* Compute at most `cosines` of the table's lines * period cosines. Returns true when the table is complete. */
bool law_excitation_continue(law_excitation_work *w, uint32_t cosines);

void law_excitation_reset(law_excitation_state *s, const law_excitation *p, const int16_t *table);

/* Return the effort along the position (quanta * 2^LAW_LINE_BITS), `elapsed` ticks after the previous call. */
int32_t law_excitation_run(law_excitation_state *s, const law_excitation *p, uint32_t elapsed);

/* Phase of a line at tick 0, in 2^-32 turns. Hashed: with z = seed + 0x9E3779B9 * (line + 1),
 * z = (z ^ z >> 16) * 0x85EBCA6B; z = (z ^ z >> 13) * 0xC2B2AE35; phase = z ^ z >> 16, all modulo 2^32.
 * Schroeder's, for equal lines: -line * (line + 1) / 2 * floor(2^32 / lines). */
uint32_t law_line_phase(uint32_t seed, uint32_t line);

/* Cosine of a phase in 2^-32 turns, times 2^LAW_COSINE_BITS; within 4.8e-6 of the true one, the same integer
 * everywhere. */
int32_t law_cosine(uint32_t phase);

#endif
