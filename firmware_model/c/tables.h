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
    AT_ACTIVITY
};

/* ranges of those that have at most 16 bits */
static const struct {
    uint8_t word;
    uint8_t least;
    uint16_t most;
} image_range[] = {
    {AT_VERSION, 6U, 6U},
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
    {AT_RESTART, 0U, 1016U},
    {AT_TRUST, 0U, 368U}};

/* tables, in the order in which they lie behind the header */
enum {
    TABLE_DISPLACEMENT,
    TABLE_LOOKUP,
    TABLE_PLACES,
    TABLE_LEVEL,
    TABLE_MEAN,
    TABLE_PLACE_ACTIVITY,
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
    bytes[TABLE_PLACE_ACTIVITY] = (image[AT_PLACES_PER_WINDOW] != 0U) ? (image[AT_PLACES]) : 0U;
}

/* Costs of steps with fraction bits, by the activity of the window less that of the
 * place that is reached: a row for each half octave from -6 to 2. */
#define ROWS 17U
#define STEPS 4U /* of 0 places on, with one place per window */
#define HALF_STEPS 7U /* of 0 places on, with places at half windows */

static const uint8_t activity_costs[ROWS][STEPS] = {
    {4U, 24U, 47U, 71U},
    {4U, 22U, 43U, 66U},
    {4U, 20U, 39U, 61U},
    {4U, 17U, 36U, 57U},
    {4U, 15U, 32U, 52U},
    {4U, 12U, 28U, 48U},
    {4U, 10U, 24U, 43U},
    {4U, 7U, 20U, 38U},
    {4U, 5U, 17U, 34U},
    {4U, 3U, 13U, 30U},
    {5U, 1U, 10U, 26U},
    {7U, 0U, 8U, 22U},
    {9U, 0U, 6U, 20U},
    {11U, 0U, 5U, 18U},
    {15U, 1U, 5U, 17U},
    {19U, 3U, 5U, 16U},
    {22U, 4U, 4U, 15U}};

static const uint8_t half_place_costs[ROWS][HALF_STEPS] = {
    {4U, 17U, 44U, 63U, 80U, 107U, 120U},
    {4U, 15U, 39U, 57U, 73U, 100U, 111U},
    {4U, 14U, 35U, 51U, 67U, 92U, 103U},
    {4U, 12U, 31U, 45U, 60U, 84U, 95U},
    {4U, 10U, 26U, 40U, 53U, 77U, 87U},
    {4U, 8U, 22U, 34U, 46U, 69U, 79U},
    {4U, 6U, 18U, 28U, 40U, 62U, 70U},
    {4U, 4U, 14U, 22U, 33U, 54U, 62U},
    {5U, 3U, 10U, 17U, 27U, 47U, 55U},
    {5U, 1U, 6U, 11U, 20U, 40U, 46U},
    {6U, 1U, 2U, 7U, 14U, 33U, 39U},
    {8U, 1U, 1U, 4U, 10U, 28U, 34U},
    {12U, 3U, 0U, 2U, 7U, 24U, 29U},
    {17U, 6U, 1U, 1U, 5U, 22U, 26U},
    {23U, 11U, 2U, 1U, 4U, 20U, 24U},
    {30U, 16U, 6U, 3U, 5U, 20U, 23U},
    {37U, 21U, 8U, 4U, 5U, 20U, 22U}};

#endif
