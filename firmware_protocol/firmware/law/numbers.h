/* Integers as rig.control._fixed_point has them, to the bit. */
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
    return (int32_t)value == value ? (int32_t)value : value > 0 ? INT32_MAX : INT32_MIN;
}

static inline int64_t law_with_sign(int64_t value, int32_t sign)
{
    return sign < 0 ? -value : value;
}

/* a * b, whole. A processor without a long multiplication (Cortex-M0+) is given four short ones: the compiler would
 * call a multiplication of 64 by 64 bits. */
static inline int64_t law_product(int32_t a, int32_t b)
{
#if defined(__ARM_ARCH_6M__) || defined(LAW_SHORT_MULTIPLIER)
    const uint32_t a_low = (uint32_t)a & 0xFFFFU, b_low = (uint32_t)b & 0xFFFFU;
    const int32_t a_high = a >> 16, b_high = b >> 16;
    const uint32_t low = a_low * b_low;
    const int32_t middle = a_high * (int32_t)b_low + (int32_t)(low >> 16);
    const int32_t other = b_high * (int32_t)a_low + (middle & 0xFFFF);
    const int32_t high = a_high * b_high + (middle >> 16) + (other >> 16);
    return (int64_t)((uint64_t)(uint32_t)high << 32 | (uint32_t)other << 16 | (low & 0xFFFFU));
#else
    return (int64_t)a * b;
#endif
}

/* value >> bits, 0 <= bits <= 62. A processor without a barrel for two words is given its two halves: the compiler
 * would call a function. */
static inline int64_t law_shift(int64_t value, int32_t bits)
{
#if defined(__ARM_ARCH_6M__) || defined(LAW_SHORT_MULTIPLIER)
    const int32_t high = (int32_t)(value >> 32);
    const uint32_t low = (uint32_t)((uint64_t)value & UINT32_MAX);
    if (bits >= 32)
        return high >> (bits - 32);
    return (int64_t)((uint64_t)(uint32_t)(high >> bits) << 32 | (low >> bits | (uint32_t)high << 1 << (31 - bits)));
#else
    return value >> bits;
#endif
}

/* value * 2^bits, 1 <= bits <= 31. */
static inline int64_t law_shift_left(int32_t value, int32_t bits)
{
#if defined(__ARM_ARCH_6M__) || defined(LAW_SHORT_MULTIPLIER)
    return (int64_t)((uint64_t)(uint32_t)(value >> (32 - bits)) << 32 | (uint32_t)value << bits);
#else
    return (int64_t)value * ((int64_t)1 << bits);
#endif
}

/* value / 2^bits, rounded, without a second shift by a variable; 0 <= bits <= 62, and -value must fit 64 bits. */
static inline int64_t law_shift_right(int64_t value, int32_t bits, int32_t rounding)
{
    if (rounding == LAW_NEAREST && bits > 0)
        return (law_shift(value, bits - 1) + 1) >> 1;
    if (rounding == LAW_ZERO && value < 0)
        return -law_shift(-value, bits);
    return law_shift(value, bits);
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

/* -value or value, saturated. */
static inline int32_t law_signed(int32_t value, int32_t sign)
{
    return sign >= 0 ? value : value == INT32_MIN ? INT32_MAX : -value;
}

/* value * share / 2^15, rounded down; the share is 0 ... 2^15, so that the result fits as the value does. */
static inline int64_t law_part(int64_t value, uint32_t share)
{
    const int64_t whole = value >> 15;
    const uint32_t rest = (uint32_t)((uint64_t)value & 0x7FFF), low = (uint32_t)((uint64_t)whole & UINT32_MAX);
    const int32_t high = (int32_t)(whole >> 32); /* 16 bits and a sign: with the share, 32 bits */
    const uint32_t a = (low & 0xFFFF) * share + (rest * share >> 15), b = (low >> 16) * share;
    return (int64_t)((uint64_t)(uint32_t)(high * (int32_t)share) << 32) + (int64_t)((uint64_t)b << 16) + a;
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
