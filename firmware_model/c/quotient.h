/* Division, rounded down, outside of inner loops: by the processor's instruction where it has one.
 *
 * The divisor is 1 to 2^31. Without the instruction the quotient comes a bit at a time, so that no
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
    uint32_t left = dividend;
    uint32_t rest = 0U;
    uint32_t found = 0U;
    for (uint32_t i = 0U; i < 32U; i++) {
        rest = (rest << 1) | (left >> 31);
        left <<= 1;
        found <<= 1;
        if (rest >= divisor) {
            rest -= divisor;
            found++;
        }
    }
    return found;
}

#endif

#endif
