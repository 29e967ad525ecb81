/* Division, rounded down, outside of inner loops: by the processor's instruction where it has one.
 *
 * The divisor is at least 1. Without the instruction the quotient comes a bit at a time, so that no
 * library is needed.
 */
#ifndef VPR_QUOTIENT_H
#define VPR_QUOTIENT_H

#include <stdint.h>

#if defined(__ARM_FEATURE_IDIV)

static inline uint32_t quotient(uint32_t dividend, uint32_t divisor)
{
    return dividend / divisor;
}

#else

static uint32_t quotient(uint32_t dividend, uint32_t divisor)
{
    uint32_t shifted = divisor;
    uint32_t bit = 1U;
    uint32_t rest = dividend;
    uint32_t result = 0U;
    while (shifted <= (rest >> 1)) {
        shifted <<= 1;
        bit <<= 1;
    }
    while (bit != 0U) {
        if (rest >= shifted) {
            rest -= shifted;
            result += bit;
        }
        shifted >>= 1;
        bit >>= 1;
    }
    return result;
}

#endif

#endif
