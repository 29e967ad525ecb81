/* The place filter: one metric a place, advanced in place, window by window. Part of vpr.c.
 *
 * Costs come with their fraction bits. No sum here is above 32 bits: distances have 16 and there
 * are as many places at most, metrics have 10 and costs less, the reciprocal has 17.
 */
#ifndef VPR_FILTER_H
#define VPR_FILTER_H

#include <stddef.h>

#include "quotient.h"
#include "sad.h"
#include "tables.h"
#include "vpr.h"

#define METRIC_TOP 1023U
#define EVIDENCE_TOP 255U
#define EVIDENCE_SHIFT 14U /* fraction bits of the reciprocal, less those of a metric */
#define RECIPROCAL_ONE 0x10000U
#define TRUST_FRACTION_BITS 4U
#define TRUST_SHIFT 2U
#define MARGIN_TOP 23U
#define STANDING_SHIFT 4U
#define WEIGHT_BITS 3U
#define WEIGHT_TOP 8U
#define WEIGHT_FROM (-48) /* activity against the mean, from which on evidence has weight */
#define COST_ROW_SHIFT 3U
#define ROW_ORIGIN 100 /* the row of the same activity is 12 times 8 from the first; half of 8 rounds */

/* What a step to a place costs. */
typedef struct {
    const int8_t *place_activity;
    int32_t activity; /* of the window, so that it gives the row of a place */
    uint32_t steps;   /* of 0, 1 ... places that have a cost */
    uint32_t least;   /* metric */
    uint32_t limit;   /* what any place costs at most: a restart */
} costs_t;

/* Statistics of the distances of a window. */
typedef struct {
    uint32_t nearest;
    uint32_t mean;
    uint32_t reciprocal;
    uint32_t weight;
} scale_t;

static inline uint32_t lesser(uint32_t a, uint32_t b)
{
    return (a < b) ? a : b;
}

/* Move a value by 1 / 2^shift of its difference to a target, rounded down. */
static uint32_t moved(uint32_t value, uint32_t target, uint32_t shift)
{
    if (target >= value) {
        return value + ((target - value) >> shift);
    }
    return value - (((value - target) + ((1U << shift) - 1U)) >> shift);
}

/* The row of costs of steps to a place of this activity. */
static inline uint32_t row_of(int32_t activity, int32_t of_place)
{
    const int32_t above = activity - of_place;
    return (above > 0) ? lesser((uint32_t)above >> COST_ROW_SHIFT, ROWS - 1U) : 0U;
}

/* Cost of the cheapest path to a place by any step: metrics at and below it have not changed yet. */
static uint32_t cheapest(const costs_t *p, const uint16_t *metric, uint32_t at)
{
    const uint32_t steps = lesser(p->steps, at + 1U);
    const uint32_t row = row_of(p->activity, p->place_activity[at]);
    const uint8_t *const costs = (p->steps == STEPS) ? activity_costs[row] : half_place_costs[row];
    uint32_t found = p->limit + p->least;
    for (uint32_t i = 0U; i < steps; i++) {
        found = lesser(found, (uint32_t)metric[at - i] + costs[i]);
    }
    return found - p->least;
}

/* The same for places from the fourth on, with one place per window: metrics stay in registers. */
static inline void predict_whole(const costs_t *p, uint16_t *metric, uint32_t end)
{
    const int8_t *const place_activity = p->place_activity;
    const int32_t activity = p->activity;
    const uint32_t least = p->least;
    const uint32_t limit = p->limit + least;
    uint32_t here = metric[end - 1U];
    uint32_t below = metric[end - 2U];
    uint32_t lower = metric[end - 3U];
    for (uint32_t at = end - 1U; at >= (STEPS - 1U); at--) {
        const uint8_t *const costs = activity_costs[row_of(activity, place_activity[at])];
        const uint32_t lowest = metric[at - 3U];
        uint32_t path = lesser(lesser(limit, here + costs[0]), below + costs[1]);
        path = lesser(lesser(path, lower + costs[2]), lowest + costs[3]);
        metric[at] = (uint16_t)(path - least);
        here = below;
        below = lower;
        lower = lowest;
    }
}

/* Put the prediction in the place of the metric, from the last place to the first: steps lead from
 * lower places, which have not changed by then. */
static void predict(const costs_t *p, uint16_t *metric, uint32_t places)
{
    uint32_t end = places;
    if ((p->steps == STEPS) && (end >= STEPS)) {
        predict_whole(p, metric, end);
        end = STEPS - 1U;
    }
    while (end > 0U) {
        end--;
        metric[end] = (uint16_t)cheapest(p, metric, end);
    }
}

/* Add the evidence to the predictions; the sum of the deviations from the mean. */
static uint32_t add_evidence(const vpr_design_t *d, vpr_state_t *s, const scale_t *scale)
{
    const uint16_t *const distances = s->distance;
    const uint32_t nearest = scale->nearest;
    const uint32_t mean = scale->mean;
    const uint32_t reciprocal = scale->reciprocal;
    const uint32_t weight = scale->weight;
    uint32_t deviations = 0U;
    uint16_t *const metrics = s->metric;
    uint32_t least = VPR_NONE;
    for (uint32_t i = d->place_count; i > 0U; i--) {
        const uint32_t distance = distances[i - 1U];
        const uint32_t scaled = ((distance - nearest) * reciprocal) >> EVIDENCE_SHIFT;
        const uint32_t against = (lesser(scaled, EVIDENCE_TOP) * weight) >> WEIGHT_BITS;
        const uint32_t value = lesser(metrics[i - 1U] + against, METRIC_TOP);
        metrics[i - 1U] = (uint16_t)value;
        deviations += (distance < mean) ? (mean - distance) : (distance - mean);
        least = lesser(least, value);
    }
    s->least = least;
    return deviations;
}

/* Keep the distances to all places. */
static void compare(const vpr_design_t *d, vpr_state_t *s)
{
    uint16_t *const distance = s->distance;
    const uint8_t *codes = d->places;
    for (uint32_t i = 0U; i < d->place_count; i++) {
        distance[i] = (uint16_t)sad(s->query, codes, d->stride);
        codes = &codes[d->stride];
    }
}

/* The sum of the distances, and the least of them. */
static uint32_t total_of(const vpr_design_t *d, const vpr_state_t *s, uint32_t *nearest)
{
    uint32_t least = VPR_NONE;
    uint32_t total = 0U;
    for (uint32_t i = 0U; i < d->place_count; i++) {
        const uint32_t distance = s->distance[i];
        total += distance;
        least = lesser(least, distance);
    }
    *nearest = least;
    return total;
}

/* The sum of the deviations from the mean. */
static uint32_t deviations_of(const vpr_design_t *d, const vpr_state_t *s, uint32_t mean)
{
    uint32_t sum = 0U;
    for (uint32_t i = 0U; i < d->place_count; i++) {
        const uint32_t distance = s->distance[i];
        sum += (distance < mean) ? (mean - distance) : (distance - mean);
    }
    return sum;
}

/* The reciprocal of the spread, from the sum of the deviations. */
static uint32_t reciprocal_of(const vpr_design_t *d, uint32_t deviations)
{
    const uint32_t spread = quotient(deviations, d->place_count);
    return quotient(RECIPROCAL_ONE, (spread == 0U) ? 1U : spread);
}

/* Advance by a window that does not pause. The first one is scaled by its own spread, the others by
 * that of the window before. `scale` is set. */
static void advance_by_evidence(const vpr_design_t *d, vpr_state_t *s, const costs_t *p,
                                scale_t *scale)
{
    compare(d, s);
    scale->mean = quotient(total_of(d, s, &scale->nearest), d->place_count);
    if (s->reciprocal == 0U) {
        s->reciprocal = reciprocal_of(d, deviations_of(d, s, scale->mean));
    }
    scale->reciprocal = s->reciprocal;
    predict(p, s->metric, d->place_count);
    s->reciprocal = reciprocal_of(d, add_evidence(d, s, scale));
}

/* Advance by a window that pauses, without evidence. */
static void advance_paused(const vpr_design_t *d, vpr_state_t *s, const costs_t *p)
{
    predict(p, s->metric, d->place_count);
    s->least = VPR_NONE;
    for (uint32_t place = 0U; place < d->place_count; place++) {
        s->least = lesser(s->least, s->metric[place]);
    }
}

/* How many eighths of the evidence of a window count that does not pause. */
static uint32_t weight_of(int32_t activity)
{
    const int32_t above = activity - WEIGHT_FROM;
    return (above > 0) ? lesser((uint32_t)above >> 1, WEIGHT_TOP) : 0U;
}

/* Costs of this window's steps. */
static void set_costs(const vpr_design_t *d, const vpr_state_t *s, costs_t *p)
{
    p->place_activity = d->place_activity;
    p->activity = s->activity + ROW_ORIGIN;
    p->steps = d->steps;
    p->least = s->least;
    /* before the first window, each place is as likely as another */
    p->limit = (s->place == VPR_NONE) ? 0U : d->restart;
}

/* The least metric of some places, into the second best: ties to the lowest place. */
static void search_second(const uint16_t *metric, uint32_t from, uint32_t end, vpr_match_t *m)
{
    uint32_t least = m->second_sum;
    for (uint32_t place = from; place < end; place++) {
        if (metric[place] < least) {
            least = metric[place];
            m->second = place;
        }
    }
    m->second_sum = least;
}

/* The lowest place of the least metric, how many others have it, and the second best. */
static void search_places(const vpr_design_t *d, const uint16_t *metric, vpr_match_t *m)
{
    uint32_t best = 0U;
    uint32_t least = metric[0];
    uint32_t ties = 0U;
    for (uint32_t place = 1U; place < d->place_count; place++) {
        const uint32_t value = metric[place];
        if (value < least) {
            least = value;
            best = place;
            ties = 0U;
        } else if (value == least) {
            ties++;
        } else {
            /* neither */
        }
    }
    m->place = best;
    m->sum = least;
    m->ties = ties;
    m->second = VPR_NONE;
    m->second_sum = VPR_NONE;
    search_second(metric, 0U, (best > d->exclusion) ? (best - d->exclusion) : 0U, m);
    search_second(metric, best + d->exclusion + 1U, d->place_count, m);
}

/* Evidence against a place in a window that does not pause, 0 to 255. The specification limits it
 * to 23, which leaves no trust: any larger number does the same. */
static uint32_t residual_of(const vpr_state_t *s, const scale_t *scale, uint32_t place)
{
    return ((((s->distance[place] - scale->nearest) * scale->reciprocal) >> EVIDENCE_SHIFT) *
            scale->weight) >>
           WEIGHT_BITS;
}

/* Trust the match by its margin, and by those before it as long as it follows from them; less what
 * speaks against it and the two matches before. */
static void trust(const vpr_design_t *d, vpr_state_t *s, uint32_t residual, vpr_match_t *m)
{
    const uint32_t margin = (m->second == VPR_NONE) ? METRIC_TOP : (m->second_sum - m->sum);
    const bool follows = (s->place != VPR_NONE) && ((m->place - s->place) < d->steps);
    const uint32_t kept = follows ? s->support : 0U;
    const uint32_t stood = kept - (kept >> STANDING_SHIFT);
    s->support = moved(kept, lesser(margin, MARGIN_TOP) << TRUST_FRACTION_BITS, TRUST_SHIFT);
    if (m->place == s->place) {
        s->support = lesser(s->support, stood); /* repeated views add no information */
    }
    s->place = m->place;
    uint32_t worst = (s->residual > s->residual_before) ? s->residual : s->residual_before;
    worst = ((residual > worst) ? residual : worst) << TRUST_FRACTION_BITS;
    m->trust = s->support - lesser(s->support, worst);
    s->residual_before = s->residual;
    s->residual = residual;
}

/* Advance by the window that ended last, and search it. */
static void filter_places(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m)
{
    costs_t costs;
    set_costs(d, s, &costs);
    scale_t scale = {VPR_NONE, 0U, 0U, weight_of(s->activity)};
    if (s->paused) {
        advance_paused(d, s, &costs);
    } else {
        advance_by_evidence(d, s, &costs, &scale);
    }
    search_places(d, s->metric, m);
    trust(d, s, s->paused ? 0U : residual_of(s, &scale, m->place), m);
}

#endif
