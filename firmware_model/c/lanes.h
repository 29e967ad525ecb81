/* Four numbers of at most 127 in a word, in the processor's own instructions. Part of filter.h. */
#ifndef VPR_LANES_H
#define VPR_LANES_H

#include <stdint.h>

#define EACH 0x01010101U
#define LANE_TOP 127U

#if defined(__ARM_FEATURE_SIMD32)

#include <arm_acle.h>

/* The lesser of each pair. */
static inline uint32_t lesser_each(uint32_t a, uint32_t b)
{
    (void)__usub8(a, b); /* says of each whether a is not below b */
    return __sel(b, a);
}

/* The sum of each pair, at most 127. */
static inline uint32_t added_each(uint32_t a, uint32_t b)
{
    return (uint32_t)__qadd8((int8x4_t)a, (int8x4_t)b);
}

#else

/* The highest bits of bytes, and ones in all bits of those whose highest bit is set. */
#define HIGHEST 0x80808080U

static inline uint32_t lesser_each(uint32_t a, uint32_t b)
{
    const uint32_t not_below = ((a | HIGHEST) - b) & HIGHEST;
    const uint32_t takes_b = not_below - (not_below >> 7); /* 7 bits are enough */
    return a ^ ((a ^ b) & takes_b);
}

static inline uint32_t added_each(uint32_t a, uint32_t b)
{
    const uint32_t sum = a + b; /* at most 254: no lane carries into the next */
    const uint32_t above = sum & HIGHEST;
    return (sum | (above - (above >> 7))) & ~HIGHEST;
}

#endif

/* Four bytes as a word, wherever they lie. */
static inline uint32_t four(const uint8_t *at)
{
    return (uint32_t)at[0] | ((uint32_t)at[1] << 8) | ((uint32_t)at[2] << 16) |
           ((uint32_t)at[3] << 24);
}

#endif
