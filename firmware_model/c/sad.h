/* Sum of absolute differences of two rows of bytes, in the processor's own instructions.
 *
 * Rows are aligned to 16 bytes, and a multiple of 16 long; their padding is equal, so that it adds
 * nothing. The sum is at most 16 bits wide (vpr_open sees to it), which is what the 16-bit lanes of
 * the vector version rely on.
 */
#ifndef VPR_SAD_H
#define VPR_SAD_H

#include <stdint.h>

#if defined(__ARM_NEON)

#include <arm_neon.h>

static inline uint32_t sad(const uint8_t *a, const uint8_t *b, uint32_t bytes)
{
    uint16x8_t sum = vdupq_n_u16(0U);
    const uint8_t *const end = &a[bytes];
    while (a != end) {
        sum = vpadalq_u8(sum, vabdq_u8(vld1q_u8(a), vld1q_u8(b)));
        a = &a[16];
        b = &b[16];
    }
    return vaddlvq_u16(sum);
}

#elif defined(__ARM_FEATURE_SIMD32)

#include <arm_acle.h>

static inline uint32_t sad(const uint8_t *a, const uint8_t *b, uint32_t bytes)
{
    /* MISRA deviation 11.3: the rows are aligned, and bytes are read four at a time */
    const uint32_t *p = (const uint32_t *)(const void *)a;
    const uint32_t *q = (const uint32_t *)(const void *)b;
    const uint32_t *const end = &p[bytes / 4U];
    uint32_t sum = 0U;
    while (p != end) {
        sum = __usada8(p[0], q[0], sum);
        sum = __usada8(p[1], q[1], sum);
        sum = __usada8(p[2], q[2], sum);
        sum = __usada8(p[3], q[3], sum);
        p = &p[4];
        q = &q[4];
    }
    return sum;
}

#else

static inline uint32_t sad(const uint8_t *a, const uint8_t *b, uint32_t bytes)
{
    uint32_t sum = 0U;
    for (uint32_t i = 0U; i < bytes; i++) {
        sum += (a[i] < b[i]) ? ((uint32_t)b[i] - a[i]) : ((uint32_t)a[i] - b[i]);
    }
    return sum;
}

#endif

#endif
