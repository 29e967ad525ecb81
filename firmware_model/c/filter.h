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
#include "vpr.h"

#define METRIC_TOP 1023U
#define EVIDENCE_TOP 255U
#define EVIDENCE_SHIFT 14U /* fraction bits of the reciprocal, less those of a metric */
#define RECIPROCAL_ONE 0x10000U
#define TRUST_BITS 4U
#define TRUST_SHIFT 2U
#define MARGIN_TOP 23U
#define STANDING_SHIFT 4U
#define FEW_STEPS 3U /* what a match may always follow by, from 0 on */
#define STEPS_MAX 16U
#define NEAR 4U      /* steps whose metrics stay in registers: 0 to 3 places */
#define HALF_STEPS 7U /* of places at half windows: 0 to 6 places */
#define BLOCK 16U    /* places whose distances are at hand at once */
#define FAR 0xFFFFU /* metric of a place off the map, and cost of a step that there is not */
#define WEIGHT_BITS 3U
#define WEIGHT_TOP 8U
#define WEIGHT_FROM 48 /* activity below the usual from which on evidence has weight */
#define ROWS 17U
#define ROW_BITS 3U
#define ROW_ORIGIN 100 /* the row of the same activity is 12 times 8 from the first; half of 8 rounds */

/* Costs of a step of 0, 1, 2 and 3 places, with fraction bits, by the activity of the window
 * against that of the place that is reached: from 6 octaves below to 2 above, in half octaves. */
static const uint8_t activity_costs[ROWS][NEAR] = {
    {4U, 24U, 47U, 71U}, {4U, 22U, 43U, 66U}, {4U, 20U, 39U, 61U}, {4U, 17U, 36U, 57U},
    {4U, 15U, 32U, 52U}, {4U, 12U, 28U, 48U}, {4U, 10U, 24U, 43U}, {4U, 7U, 20U, 38U},
    {4U, 5U, 17U, 34U},  {4U, 3U, 13U, 30U},  {5U, 1U, 10U, 26U},  {7U, 0U, 8U, 22U},
    {9U, 0U, 6U, 20U},   {11U, 0U, 5U, 18U},  {15U, 1U, 5U, 17U},  {19U, 3U, 5U, 16U},
    {22U, 4U, 4U, 15U}};

/* The same of a step of 0 to 6 places at half windows. */
static const uint8_t half_place_costs[ROWS][HALF_STEPS] = {
    {4U, 17U, 44U, 63U, 80U, 107U, 120U}, {4U, 15U, 39U, 57U, 73U, 100U, 111U},
    {4U, 14U, 35U, 51U, 67U, 92U, 103U},  {4U, 12U, 31U, 45U, 60U, 84U, 95U},
    {4U, 10U, 26U, 40U, 53U, 77U, 87U},   {4U, 8U, 22U, 34U, 46U, 69U, 79U},
    {4U, 6U, 18U, 28U, 40U, 62U, 70U},    {4U, 4U, 14U, 22U, 33U, 54U, 62U},
    {5U, 3U, 10U, 17U, 27U, 47U, 55U},    {5U, 1U, 6U, 11U, 20U, 40U, 46U},
    {6U, 1U, 2U, 7U, 14U, 33U, 39U},      {8U, 1U, 1U, 4U, 10U, 28U, 34U},
    {12U, 3U, 0U, 2U, 7U, 24U, 29U},      {17U, 6U, 1U, 1U, 5U, 22U, 26U},
    {23U, 11U, 2U, 1U, 4U, 20U, 24U},     {30U, 16U, 6U, 3U, 5U, 20U, 23U},
    {37U, 21U, 8U, 4U, 5U, 20U, 22U}};

/* What a step to a place costs. Near costs are less the least metric: they wrap where they are below
 * it, and their sum with a metric does not. */
typedef struct {
    const int8_t *place_activity; /* NULL: steps cost the same to all places */
    int32_t activity;             /* of the window, so that it gives the row of a place */
    uint32_t steps;               /* of 0, 1 ... places that have a cost */
    uint32_t near[NEAR];          /* of the first of these if they do */
    const uint16_t *fixed;        /* of all of these if they do, in the design */
    const uint16_t *back; /* of -1, -2 ... */
    uint32_t back_count;
    uint32_t least;
    uint32_t limit;            /* what any place costs at most: a restart */
    uint32_t above;            /* metrics in `ahead` */
    uint16_t ahead[STEPS_MAX]; /* of the places above the present one, before they changed */
} costs_t;

/* Places next to one another, and the distances to them. */
typedef struct {
    uint32_t from;
    uint32_t end; /* behind the last one */
    const uint16_t *distance;
} block_t;

/* What the distances of a window have in common. */
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
    return (above > 0) ? lesser((uint32_t)above >> ROW_BITS, ROWS - 1U) : 0U;
}

/* Cost of the cheapest path to a place by any step: metrics at and below it have not changed yet,
 * and those above it are in the delay line. */
static uint32_t cheapest(const costs_t *p, const uint16_t *metric, uint32_t at)
{
    const uint32_t steps = lesser(p->steps, at + 1U);
    uint32_t found = p->limit + p->least;
    if (p->place_activity != NULL) {
        const uint32_t row = row_of(p->activity, p->place_activity[at]);
        const uint8_t *const costs =
            (p->steps == NEAR) ? activity_costs[row] : half_place_costs[row];
        for (uint32_t i = 0U; i < steps; i++) {
            found = lesser(found, (uint32_t)metric[at - i] + costs[i]);
        }
    } else {
        for (uint32_t i = 0U; i < steps; i++) {
            found = lesser(found, (uint32_t)metric[at - i] + p->fixed[i]);
        }
    }
    for (uint32_t i = 0U; i < p->above; i++) {
        found = lesser(found, (uint32_t)p->ahead[i] + p->back[i]);
    }
    return found - p->least;
}

/* Move the delay line of the metrics above by one place. */
static void shift_ahead(costs_t *p, uint16_t metric)
{
    if (p->above < p->back_count) {
        p->above++;
    }
    for (uint32_t i = p->above; i > 1U; i--) {
        p->ahead[i - 1U] = p->ahead[i - 2U];
    }
    p->ahead[0] = metric;
}

/* The same for places from the fourth on, in a design without other steps than the near ones. */
static inline void predict_near(const costs_t *p, uint16_t *metric, uint32_t from, uint32_t end)
{
    const uint32_t limit = p->limit;
    const uint32_t stay = p->near[0];
    const uint32_t one = p->near[1];
    const uint32_t two = p->near[2];
    const uint32_t three = p->near[3];
    uint32_t here = metric[end - 1U];
    uint32_t below = metric[end - 2U];
    uint32_t lower = metric[end - 3U];
    for (uint32_t at = end - 1U; at >= from; at--) {
        const uint32_t lowest = metric[at - 3U];
        uint32_t path = lesser(lesser(limit, here + stay), below + one);
        path = lesser(lesser(path, lower + two), lowest + three);
        metric[at] = (uint16_t)path;
        here = below;
        below = lower;
        lower = lowest;
    }
}

/* The same where steps cost what the activities of the window and of the place say. */
static inline void predict_by_activity(const costs_t *p, uint16_t *metric, uint32_t from,
                                       uint32_t end)
{
    const int8_t *const place_activity = p->place_activity;
    const int32_t activity = p->activity;
    const uint32_t least = p->least;
    const uint32_t limit = p->limit + least;
    uint32_t here = metric[end - 1U];
    uint32_t below = metric[end - 2U];
    uint32_t lower = metric[end - 3U];
    for (uint32_t at = end - 1U; at >= from; at--) {
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

/* Put the prediction in the place of the metric, from the last place of a block to the first: steps
 * lead from lower places, which have not changed by then. */
static void predict(costs_t *p, uint16_t *metric, const block_t *b)
{
    uint32_t end = b->end;
    if ((p->steps <= NEAR) && (p->back_count == 0U) && (end >= NEAR)) {
        const uint32_t from = (b->from < (NEAR - 1U)) ? (NEAR - 1U) : b->from;
        if (p->place_activity != NULL) {
            predict_by_activity(p, metric, from, end);
        } else {
            predict_near(p, metric, from, end);
        }
        end = from;
    }
    while (end > b->from) {
        end--;
        const uint16_t before = metric[end];
        metric[end] = (uint16_t)cheapest(p, metric, end);
        shift_ahead(p, before);
    }
}

/* Add the evidence to the predictions of a block; the sum of the deviations from the mean. */
static uint32_t add_evidence(const scale_t *scale, uint16_t *metric, const block_t *b,
                             uint32_t *least)
{
    const uint16_t *const distances = b->distance;
    const uint32_t nearest = scale->nearest;
    const uint32_t mean = scale->mean;
    const uint32_t reciprocal = scale->reciprocal;
    const uint32_t weight = scale->weight;
    uint32_t deviations = 0U;
    uint16_t *const metrics = &metric[b->from];
    uint32_t found = *least;
    for (uint32_t i = b->end - b->from; i > 0U; i--) {
        const uint32_t distance = distances[i - 1U];
        const uint32_t scaled = ((distance - nearest) * reciprocal) >> EVIDENCE_SHIFT;
        const uint32_t against = (lesser(scaled, EVIDENCE_TOP) * weight) >> WEIGHT_BITS;
        const uint32_t value = lesser(metrics[i - 1U] + against, METRIC_TOP);
        metrics[i - 1U] = (uint16_t)value;
        deviations += (distance < mean) ? (mean - distance) : (distance - mean);
        found = lesser(found, value);
    }
    *least = found;
    return deviations;
}

/* Distances to the places of a block. */
static void compare(const vpr_design_t *d, const uint8_t *query, uint32_t from, uint32_t end,
                    uint16_t *distance)
{
    const uint8_t *codes = &d->places[from * d->stride];
    for (uint32_t i = 0U; i < (end - from); i++) {
        distance[i] = (uint16_t)sad(query, codes, d->stride);
        codes = &codes[d->stride];
    }
}

/* The sum of the deviations from the mean. */
static uint32_t deviations_of(const block_t *b, uint32_t mean)
{
    uint32_t sum = 0U;
    for (uint32_t i = 0U; i < (b->end - b->from); i++) {
        const uint32_t distance = b->distance[i];
        sum += (distance < mean) ? (mean - distance) : (distance - mean);
    }
    return sum;
}

/* The sum of the distances, and the least of them. */
static uint32_t total_of(const block_t *b, uint32_t *nearest)
{
    uint32_t least = *nearest;
    uint32_t total = 0U;
    for (uint32_t i = 0U; i < (b->end - b->from); i++) {
        const uint32_t distance = b->distance[i];
        total += distance;
        least = lesser(least, distance);
    }
    *nearest = least;
    return total;
}

/* Advance by a window that does not pause, in passes over the places: for the mean of the
 * distances, for the spread, which only the first window needs beforehand, and for the metrics. If
 * the distances are not kept, each pass computes them again, a block at a time. `scale`
 * is set. */
static void advance_by_evidence(const vpr_design_t *d, vpr_state_t *s, costs_t *p, scale_t *scale)
{
    enum { FOR_MEAN, FOR_SPREAD, FOR_METRICS, PASSES };
    uint16_t room[BLOCK];
    for (uint32_t pass = FOR_MEAN; pass < PASSES; pass++) {
        uint32_t sum = 0U;
        if ((pass == FOR_SPREAD) && (s->reciprocal != 0U)) {
            continue;
        }
        scale->reciprocal = s->reciprocal;
        block_t block = {0U, d->place_count, s->distance};
        while (block.end > 0U) {
            uint16_t *const distance = d->keep_distances ? s->distance : room;
            block.from = d->keep_distances ? 0U : ((block.end - 1U) & ~(uint32_t)(BLOCK - 1U));
            block.distance = distance;
            if (!d->keep_distances || (pass == FOR_MEAN)) {
                compare(d, s->query, block.from, block.end, distance);
            }
            if (pass == FOR_MEAN) {
                sum += total_of(&block, &scale->nearest);
            } else if (pass == FOR_SPREAD) {
                sum += deviations_of(&block, scale->mean);
            } else {
                predict(p, s->metric, &block);
                sum += add_evidence(scale, s->metric, &block, &s->least);
            }
            block.end = block.from;
        }
        sum = quotient(sum, d->place_count);
        if (pass == FOR_MEAN) {
            scale->mean = sum;
        } else {
            s->reciprocal = quotient(RECIPROCAL_ONE, (sum == 0U) ? 1U : sum);
        }
    }
}

/* Advance by a window that pauses, without evidence. */
static void advance_paused(const vpr_design_t *d, vpr_state_t *s, costs_t *p)
{
    const block_t all = {0U, d->place_count, s->distance};
    predict(p, s->metric, &all);
    for (uint32_t place = 0U; place < d->place_count; place++) {
        s->least = lesser(s->least, s->metric[place]);
    }
}

/* How many eighths of the evidence of a window count that does not pause. */
static uint32_t weight_of(int32_t activity)
{
    const int32_t above = activity + WEIGHT_FROM;
    return (above > 0) ? lesser((uint32_t)above >> 1, WEIGHT_TOP) : 0U;
}

/* Costs of this window's steps. */
static void set_costs(const vpr_design_t *d, const vpr_state_t *s, costs_t *p)
{
    p->place_activity = d->place_activity;
    p->activity = s->activity + ROW_ORIGIN;
    for (uint32_t i = 0U; (i < NEAR) && (d->place_activity == NULL); i++) {
        p->near[i] = ((i < d->steps) ? d->cost[i] : FAR) - s->least;
    }
    p->steps = d->steps;
    p->fixed = d->cost;
    p->back = d->back_cost;
    p->back_count = d->back;
    p->above = 0U;
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

/* Evidence against a place in a window that does not pause. It is not limited, as above 23 it takes
 * all trust anyway, which 255 of any weight is. */
static uint32_t residual_of(const vpr_design_t *d, const vpr_state_t *s, const scale_t *scale,
                          uint32_t place)
{
    const uint32_t distance = sad(s->query, &d->places[place * d->stride], d->stride);
    return ((((distance - scale->nearest) * scale->reciprocal) >> EVIDENCE_SHIFT) *
            scale->weight) >>
           WEIGHT_BITS;
}

/* Trust the match by its margin, and by those before it as long as it follows from them; less what
 * speaks against it and the two matches before. */
static void trust(const vpr_design_t *d, vpr_state_t *s, uint32_t residual, vpr_match_t *m)
{
    const uint32_t margin = (m->second == VPR_NONE) ? METRIC_TOP : (m->second_sum - m->sum);
    const uint32_t last = ((d->steps > FEW_STEPS) ? d->steps : FEW_STEPS) - 1U;
    const bool follows =
        (s->place != VPR_NONE) && (((m->place + d->back) - s->place) <= (d->back + last));
    const uint32_t kept = follows ? s->support : 0U;
    const uint32_t stood = kept - (kept >> STANDING_SHIFT);
    s->support = moved(kept, lesser(margin, MARGIN_TOP) << TRUST_BITS, TRUST_SHIFT);
    if (m->place == s->place) {
        s->support = lesser(s->support, stood); /* the same view again says nothing new */
    }
    s->place = m->place;
    uint32_t worst = (s->residual > s->residual_before) ? s->residual : s->residual_before;
    worst = ((residual > worst) ? residual : worst) << TRUST_BITS;
    m->trust = s->support - lesser(s->support, worst);
    s->residual_before = s->residual;
    s->residual = residual;
}

/* Advance by the window that ended last, and search it. */
static void filter_places(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m)
{
    costs_t costs;
    set_costs(d, s, &costs);
    s->least = VPR_NONE;
    scale_t scale = {VPR_NONE, 0U, 0U, weight_of(s->activity)};
    if (s->paused) {
        advance_paused(d, s, &costs);
    } else {
        advance_by_evidence(d, s, &costs, &scale);
    }
    search_places(d, s->metric, m);
    trust(d, s, s->paused ? 0U : residual_of(d, s, &scale, m->place), m);
}

#endif
