/* 64-bit arithmetic for a 32-bit processor without a long multiplication and without a two-word shift (Cortex-M0+), where
 * the compiler would call a library function for each operation, in every tick. */
#ifndef HR_WIDE_H
#define HR_WIDE_H

#include <stdint.h>

static inline uint64_t wide_product(uint32_t a, uint32_t b)
{
#if defined(__ARM_ARCH_6M__)
    const uint32_t a_low = a & 0xFFFFu, a_high = a >> 16, b_low = b & 0xFFFFu, b_high = b >> 16;
    const uint32_t low = a_low * b_low;
    const uint32_t middle = a_high * b_low + (low >> 16);
    const uint32_t other = a_low * b_high + (middle & 0xFFFFu);
    const uint32_t high = a_high * b_high + (middle >> 16) + (other >> 16);
    return (uint64_t)high << 32 | (other << 16 | (low & 0xFFFFu));
#else
    return (uint64_t)a * b;
#endif
}

/* value >> bits, 0 … 31. */
static inline uint64_t wide_shift(uint64_t value, uint32_t bits)
{
#if defined(__ARM_ARCH_6M__)
    const uint32_t high = (uint32_t)(value >> 32), low = (uint32_t)(value & UINT32_MAX);
    return (uint64_t)(high >> bits) << 32 | (low >> bits | high << 1 << (31u - bits));
#else
    return value >> bits;
#endif
}

#endif
