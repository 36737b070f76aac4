/* Integers as rig.fixed_point has them, to the bit. */
#ifndef LAW_NUMBERS_H
#define LAW_NUMBERS_H

#include <stdint.h>

#include "law.h"

typedef char law_shifts_must_be_arithmetic[(-3 >> 1) == -2 ? 1 : -1];

/* Difference of two counts of a 32-bit counter that may have wrapped between them. */
static inline int32_t law_count_difference(int32_t newer, int32_t older)
{
    const uint32_t d = (uint32_t)newer - (uint32_t)older;
    return d <= (uint32_t)INT32_MAX ? (int32_t)d : -(int32_t)(UINT32_MAX - d) - 1;
}

static inline int64_t law_at_most(int64_t value, int64_t limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

static inline int32_t law_to_32(int64_t value)
{
    return value > INT32_MAX ? INT32_MAX : value < INT32_MIN ? INT32_MIN : (int32_t)value;
}

/* value / 2^bits, rounded; 0 <= bits <= 62, and value + 2^bits must fit 64 bits. */
static inline int64_t law_shift_right(int64_t value, int32_t bits, int32_t rounding)
{
    if (rounding == LAW_NEAREST)
        value += ((int64_t)1 << bits) >> 1;
    else if (rounding == LAW_ZERO && value < 0)
        value += ((int64_t)1 << bits) - 1;
    return value >> bits;
}

/* numerator / denominator, rounded; the denominator is above zero, and their sum must fit 64 bits. */
static inline int64_t law_divide(int64_t numerator, int64_t denominator, int32_t rounding)
{
    int64_t quotient;
    if (rounding == LAW_NEAREST)
        numerator += denominator >> 1;
    else if (rounding == LAW_ZERO && numerator < 0)
        numerator += denominator - 1;
    quotient = numerator / denominator;
    return numerator % denominator < 0 ? quotient - 1 : quotient;
}

/* Nearest value that fits a two's complement word of 2 to 32 bits. */
static inline int32_t law_saturate(int64_t value, int32_t word_bits)
{
    const int32_t greatest = (int32_t)(((uint32_t)1 << (word_bits - 1)) - 1);
    return value > greatest ? greatest : value < -(int64_t)greatest - 1 ? -greatest - 1 : (int32_t)value;
}

/* a + b, or the greatest there is. */
static inline uint32_t law_add(uint32_t a, uint32_t b)
{
    return a > UINT32_MAX - b ? UINT32_MAX : a + b;
}

#endif
