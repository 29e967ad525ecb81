/* Layout of the image, and costs of steps. Written by `python -m firmware_model.emulation.tables`:
 * do not edit. Part of vpr.c and filter.h. */
#ifndef VPR_TABLES_H
#define VPR_TABLES_H

#include <stdint.h>

#define IMAGE_MAGIC 0x49525056U
#define HEADER_WORDS 32U

/* words of the header */
enum {
    AT_MAGIC,
    AT_VERSION,
    AT_BYTES,
    AT_CRC,
    AT_WIDTH,
    AT_HEIGHT,
    AT_PIXELS,
    AT_STRIDE,
    AT_CODE_BITS,
    AT_CONTRAST,
    AT_PLACES,
    AT_LENGTH,
    AT_EXCLUSION,
    AT_WINDOW_KIND,
    AT_WINDOW,
    AT_TIMESTAMP_BITS,
    AT_LARGEST_SUM,
    AT_LOOKUP_DEPTH,
    AT_PLACES_PER_WINDOW,
    AT_RESTART,
    AT_TRUST,
    AT_ACTIVITY,
    AT_GAINS
};

/* ranges of those that have at most 16 bits */
static const struct {
    uint8_t word;
    uint8_t least;
    uint16_t most;
} image_range[] = {
    {AT_VERSION, 7U, 7U},
    {AT_WIDTH, 1U, 32768U},
    {AT_HEIGHT, 1U, 32768U},
    {AT_PIXELS, 1U, 65535U},
    {AT_CODE_BITS, 1U, 8U},
    {AT_CONTRAST, 0U, 1U},
    {AT_PLACES, 1U, 65535U},
    {AT_LENGTH, 1U, 65535U},
    {AT_EXCLUSION, 0U, 65535U},
    {AT_WINDOW_KIND, 0U, 1U},
    {AT_TIMESTAMP_BITS, 2U, 32U},
    {AT_PLACES_PER_WINDOW, 0U, 2U},
    {AT_RESTART, 0U, 120U},
    {AT_TRUST, 0U, 368U},
    {AT_GAINS, 0U, 7U}};

/* tables, in the order in which they lie behind the header */
enum {
    TABLE_DISPLACEMENT,
    TABLE_LOOKUP,
    TABLE_PLACES,
    TABLE_LEVEL,
    TABLE_MEAN,
    TABLE_LIMITS,
    TABLE_PLACE_ACTIVITY,
    TABLE_PLACE_BIAS,
    TABLES
};

/* Bytes of each table, without padding. */
static inline void table_bytes(const uint32_t *image, uint32_t bytes[TABLES])
{
    bytes[TABLE_DISPLACEMENT] = image[AT_HEIGHT] * 2U;
    bytes[TABLE_LOOKUP] = image[AT_LOOKUP_DEPTH] * 8U;
    bytes[TABLE_PLACES] = image[AT_PLACES] * image[AT_STRIDE];
    bytes[TABLE_LEVEL] = (image[AT_CONTRAST] != 0U) ? (1024U * 2U) : 0U;
    bytes[TABLE_MEAN] = (image[AT_CONTRAST] != 0U) ? (image[AT_PIXELS] * 2U) : 0U;
    bytes[TABLE_LIMITS] = (image[AT_CONTRAST] != 0U) ? (image[AT_PIXELS] * 2U) : 0U;
    bytes[TABLE_PLACE_ACTIVITY] = (image[AT_PLACES_PER_WINDOW] != 0U) ? (image[AT_PLACES]) : 0U;
    bytes[TABLE_PLACE_BIAS] = (image[AT_PLACES_PER_WINDOW] != 0U) ? (image[AT_PLACES]) : 0U;
}

#define COLUMNS 33U /* rows of costs of a step, the highest first */
#define STEPS 5U /* of 0 places on, with one place per window */
#define HALF_STEPS 7U /* of 0 places on, with places at half windows */

static const uint8_t whole_costs[STEPS * COLUMNS] = {
    31U, 31U, 31U, 31U, 31U, 31U, 31U, 31U, 27U, 22U, 19U, 16U, 12U, 9U, 7U, 5U, 4U, 4U, 4U, 4U, 4U,
    4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U,
    5U, 5U, 5U, 5U, 5U, 5U, 5U, 5U, 3U, 2U, 1U, 1U, 0U, 0U, 0U, 2U, 4U, 7U, 10U, 15U, 20U, 26U, 33U,
    41U, 50U, 60U, 60U, 60U, 60U, 60U, 60U, 60U, 60U,
    1U, 1U, 1U, 1U, 1U, 1U, 1U, 1U, 1U, 1U, 2U, 4U, 5U, 6U, 8U, 11U, 15U, 19U, 24U, 31U, 38U, 46U,
    54U, 64U, 74U, 85U, 85U, 85U, 85U, 85U, 85U, 85U, 85U,
    4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 5U, 6U, 8U, 10U, 12U, 15U, 18U, 22U, 26U, 32U, 38U, 45U, 53U,
    62U, 72U, 82U, 93U, 106U, 106U, 106U, 106U, 106U, 106U, 106U, 106U,
    6U, 6U, 6U, 6U, 6U, 6U, 6U, 6U, 8U, 10U, 12U, 15U, 18U, 21U, 25U, 29U, 35U, 41U, 48U, 56U, 64U,
    74U, 84U, 95U, 107U, 120U, 120U, 120U, 120U, 120U, 120U, 120U, 120U};

static const uint8_t half_costs[HALF_STEPS * COLUMNS] = {
    50U, 50U, 50U, 50U, 50U, 50U, 50U, 50U, 43U, 38U, 32U, 27U, 21U, 16U, 12U, 9U, 6U, 5U, 4U, 4U,
    4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U, 4U,
    19U, 19U, 19U, 19U, 19U, 19U, 19U, 19U, 15U, 13U, 10U, 7U, 5U, 3U, 1U, 1U, 1U, 3U, 5U, 8U, 11U,
    16U, 21U, 27U, 34U, 42U, 42U, 42U, 42U, 42U, 42U, 42U, 42U,
    6U, 6U, 6U, 6U, 6U, 6U, 6U, 6U, 5U, 3U, 2U, 1U, 0U, 0U, 0U, 2U, 4U, 7U, 10U, 15U, 20U, 26U, 33U,
    41U, 50U, 60U, 60U, 60U, 60U, 60U, 60U, 60U, 60U,
    2U, 2U, 2U, 2U, 2U, 2U, 2U, 2U, 1U, 1U, 1U, 1U, 1U, 1U, 3U, 5U, 8U, 12U, 17U, 22U, 28U, 36U,
    44U, 52U, 62U, 73U, 73U, 73U, 73U, 73U, 73U, 73U, 73U,
    1U, 1U, 1U, 1U, 1U, 1U, 1U, 1U, 1U, 1U, 2U, 3U, 3U, 5U, 7U, 10U, 13U, 18U, 23U, 29U, 36U, 44U,
    53U, 62U, 73U, 84U, 84U, 84U, 84U, 84U, 84U, 84U, 84U,
    1U, 1U, 1U, 1U, 1U, 1U, 1U, 1U, 2U, 3U, 4U, 5U, 6U, 8U, 11U, 14U, 18U, 23U, 29U, 36U, 44U, 52U,
    61U, 71U, 82U, 94U, 94U, 94U, 94U, 94U, 94U, 94U, 94U,
    1U, 1U, 1U, 1U, 1U, 1U, 1U, 1U, 2U, 4U, 5U, 7U, 8U, 11U, 14U, 17U, 22U, 28U, 34U, 41U, 49U, 58U,
    68U, 78U, 89U, 102U, 102U, 102U, 102U, 102U, 102U, 102U, 102U};

#endif
