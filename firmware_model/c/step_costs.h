/* Costs of steps with fraction bits, by the activity of the window less that of the place that is
 * reached: a row for each half octave from -6 to 2. Written by
 * `python -m firmware_model.emulation.step_costs`. Part of filter.h. */
#ifndef VPR_STEP_COSTS_H
#define VPR_STEP_COSTS_H

#include <stdint.h>

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
