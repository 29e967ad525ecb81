/* The place filter: one metric a place, advanced in place, window by window. Part of vpr.c.
 *
 * Prices come with their fraction bits. No sum here is above 32 bits: distances have 16 and there
 * are as many places at most, metrics have 10 and prices less, the reciprocal has 17.
 */
#ifndef VPR_FILTER_H
#define VPR_FILTER_H

#include "quotient.h"
#include "sad.h"
#include "vpr.h"

#define METRIC_TOP 1023U
#define EVIDENCE_TOP 255U
#define EVIDENCE_SHIFT 14U /* fraction bits of the reciprocal, less those of a metric */
#define RECIPROCAL_ONE 0x10000U
#define TRUST_BITS 4U
#define TRUST_SHIFT 2U
#define STANDING_SHIFT 4U
#define PAUSE_STEPS 3U
#define STEPS_MAX 16U
#define NEAR 4U      /* steps whose metrics stay in registers: 0 to 3 places */
#define BLOCK 16U    /* places whose distances are at hand at once */
#define FAR 0xFFFFU /* metric of a place off the map, and price of a step that there is not */

/* What a step to a place costs, less the least metric: prices wrap where they are below it, and
 * their sum with a metric does not. */
typedef struct {
    uint32_t near[NEAR]; /* of a step of 0, 1 ... */
    uint32_t near_count;
    const uint16_t *far; /* of those beyond, in the design */
    uint32_t far_count;
    const uint16_t *back; /* of -1, -2 ... */
    uint32_t back_count;
    uint32_t least;
    uint32_t limit;            /* what any place costs at most: a restart */
    uint32_t above;            /* metrics in `ahead` */
    uint16_t ahead[STEPS_MAX]; /* of the places above the present one, before they changed */
} prices_t;

/* Of the places that have their new metric. */
typedef struct {
    uint32_t place;
    uint32_t metric;
    uint32_t ties;
} least_t;

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
    uint32_t deviations; /* from the mean, summed so far */
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

/* Price of the cheapest way to a place by any step: metrics at and below it have not changed yet,
 * and those above it are in the delay line. */
static uint32_t cheapest(const prices_t *p, const uint16_t *metric, uint32_t at)
{
    uint32_t found = p->limit;
    for (uint32_t i = 0U; (i < NEAR) && (i <= at); i++) {
        found = lesser(found, metric[at - i] + p->near[i]);
    }
    for (uint32_t i = 0U; (i < p->far_count) && ((i + NEAR) <= at); i++) {
        found = lesser(found, ((uint32_t)metric[at - NEAR - i] + p->far[i]) - p->least);
    }
    for (uint32_t i = 0U; i < p->above; i++) {
        found = lesser(found, ((uint32_t)p->ahead[i] + p->back[i]) - p->least);
    }
    return found;
}

/* Move the delay line of the metrics above by one place. */
static void shift_ahead(prices_t *p, uint16_t metric)
{
    p->above = lesser(p->above + 1U, p->back_count);
    for (uint32_t i = p->above; i > 1U; i--) {
        p->ahead[i - 1U] = p->ahead[i - 2U];
    }
    p->ahead[0] = metric;
}

/* The same for places from the fourth on, in a design without other steps than the near ones. */
static inline void predict_near(const prices_t *p, uint16_t *metric, uint32_t from, uint32_t end,
                                bool of_three_places)
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
        uint32_t price = lesser(lesser(limit, here + stay), below + one);
        price = lesser(price, lower + two);
        if (of_three_places) {
            price = lesser(price, lowest + three);
        }
        metric[at] = (uint16_t)price;
        here = below;
        below = lower;
        lower = lowest;
    }
}

/* Put the prediction in the place of the metric, from the last place of a block to the first: steps
 * lead from lower places, which have not changed by then. */
static void predict(prices_t *p, uint16_t *metric, const block_t *b)
{
    uint32_t end = b->end;
    if (((p->far_count | p->back_count) == 0U) && (end >= NEAR)) {
        const uint32_t from = (b->from < (NEAR - 1U)) ? (NEAR - 1U) : b->from;
        if (p->near_count == NEAR) {
            predict_near(p, metric, from, end, true);
        } else {
            predict_near(p, metric, from, end, false);
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

/* Take a place's metric into the search; places come from the last to the first, so that the lowest
 * of equals comes last. */
static inline void search_least(least_t *f, uint32_t place, uint32_t metric)
{
    if (metric <= f->metric) {
        f->ties = (metric == f->metric) ? (f->ties + 1U) : 0U;
        f->place = place;
        f->metric = metric;
    }
}

/* Add the evidence to the predictions of a block. */
static void add_evidence(scale_t *scale, uint16_t *metric, const block_t *b, least_t *f)
{
    const uint16_t *const distances = b->distance;
    const uint32_t nearest = scale->nearest;
    const uint32_t mean = scale->mean;
    const uint32_t reciprocal = scale->reciprocal;
    uint32_t deviations = scale->deviations;
    uint16_t *const metrics = &metric[b->from];
    least_t found = *f;
    for (uint32_t i = b->end - b->from; i > 0U; i--) {
        const uint32_t distance = distances[i - 1U];
        const uint32_t scaled = ((distance - nearest) * reciprocal) >> EVIDENCE_SHIFT;
        const uint32_t value =
            lesser(metrics[i - 1U] + lesser(scaled, EVIDENCE_TOP), METRIC_TOP);
        metrics[i - 1U] = (uint16_t)value;
        deviations += (distance < mean) ? (mean - distance) : (distance - mean);
        search_least(&found, b->from + i - 1U, value);
    }
    scale->deviations = deviations;
    *f = found;
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

/* The block before the place `end`: all places below it if their distances were kept; else those
 * that there is room for, compared again. */
static block_t block_before(const vpr_design_t *d, const vpr_state_t *s, uint32_t end,
                            uint16_t *room)
{
    block_t found = {0U, end, s->distance};
    if (!d->keep_distances) {
        found.from = (end - 1U) & ~(BLOCK - 1U);
        found.distance = room;
        compare(d, s->query, found.from, end, room);
    }
    return found;
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

static uint32_t reciprocal_of(const vpr_design_t *d, uint32_t deviations)
{
    const uint32_t spread = quotient(deviations, d->place_count);
    return quotient(RECIPROCAL_ONE, (spread == 0U) ? 1U : spread);
}

/* Compare with all places: the mean distance, and the least. */
static uint32_t compare_all(const vpr_design_t *d, const vpr_state_t *s, uint32_t *nearest)
{
    uint16_t room[BLOCK];
    uint32_t total = 0U;
    uint32_t least = VPR_NONE;
    if (d->keep_distances) {
        compare(d, s->query, 0U, d->place_count, s->distance);
    }
    uint32_t end = d->place_count;
    while (end > 0U) {
        const block_t block = block_before(d, s, end, room);
        for (uint32_t i = 0U; i < (end - block.from); i++) {
            const uint32_t distance = block.distance[i];
            total += distance;
            least = lesser(least, distance);
        }
        end = block.from;
    }
    *nearest = least;
    return quotient(total, d->place_count);
}

/* Advance by a window in which the camera moved. */
static void advance_moving(const vpr_design_t *d, vpr_state_t *s, prices_t *p, least_t *f)
{
    uint16_t room[BLOCK];
    scale_t scale = {0U, 0U, 0U, 0U};
    scale.mean = compare_all(d, s, &scale.nearest);
    if (s->reciprocal == 0U) { /* the first window's is its own */
        uint32_t deviations = 0U;
        for (uint32_t end = d->place_count; end > 0U;) {
            const block_t block = block_before(d, s, end, room);
            deviations += deviations_of(&block, scale.mean);
            end = block.from;
        }
        s->reciprocal = reciprocal_of(d, deviations);
    }
    scale.reciprocal = s->reciprocal;
    for (uint32_t end = d->place_count; end > 0U;) {
        const block_t block = block_before(d, s, end, room);
        predict(p, s->metric, &block);
        add_evidence(&scale, s->metric, &block, f);
        end = block.from;
    }
    s->reciprocal = reciprocal_of(d, scale.deviations);
}

/* Advance by a window in which it stood. */
static void advance_standing(const vpr_design_t *d, vpr_state_t *s, prices_t *p, least_t *f)
{
    const block_t all = {0U, d->place_count, s->distance};
    predict(p, s->metric, &all);
    for (uint32_t place = d->place_count; place > 0U; place--) {
        search_least(f, place - 1U, s->metric[place - 1U]);
    }
}

/* Prices of this window's steps. */
static void set_prices(const vpr_design_t *d, const vpr_state_t *s, prices_t *p)
{
    static const uint16_t standing[PAUSE_STEPS] = {0U, 0U, 4U};
    const uint16_t *const price = s->paused ? standing : d->price;
    const uint32_t steps = s->paused ? PAUSE_STEPS : d->steps;
    for (uint32_t i = 0U; i < NEAR; i++) {
        p->near[i] = ((i < steps) ? price[i] : FAR) - s->least;
    }
    p->near_count = lesser(steps, NEAR);
    p->far_count = (steps > NEAR) ? (steps - NEAR) : 0U;
    p->far = &price[steps - p->far_count];
    p->back = &d->price[d->steps];
    p->back_count = s->paused ? 0U : d->back;
    p->above = 0U;
    p->least = s->least;
    /* before the first window, each place is as likely as another */
    p->limit = (s->place == VPR_NONE) ? 0U : d->restart;
}

/* The least metric of some places, into the second best: ties to the lowest place. */
static void search_second(const uint16_t *metric, uint32_t from, uint32_t end, vpr_match_t *m)
{
    for (uint32_t place = from; place < end; place++) {
        if (metric[place] < m->second_sum) {
            m->second_sum = metric[place];
            m->second = place;
        }
    }
}

/* Trust the match by its margin, and by those before it as long as it follows from them. */
static void trust(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m)
{
    const uint32_t margin = (m->second == VPR_NONE) ? METRIC_TOP : (m->second_sum - m->sum);
    const uint32_t last = ((d->steps > PAUSE_STEPS) ? d->steps : PAUSE_STEPS) - 1U;
    const bool follows =
        (s->place != VPR_NONE) && (((m->place + d->back) - s->place) <= (d->back + last));
    const uint32_t kept = follows ? s->trust : 0U;
    const uint32_t stood = kept - (kept >> STANDING_SHIFT);
    s->trust = moved(kept, margin << TRUST_BITS, TRUST_SHIFT);
    if ((m->place == s->place) && (s->trust > stood)) {
        s->trust = stood; /* the same view again says nothing new */
    }
    s->place = m->place;
    m->trust = s->trust;
}

/* Advance by the window that ended last, and search it. */
static void filter_places(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m)
{
    least_t found = {0U, VPR_NONE, 0U};
    prices_t prices;
    set_prices(d, s, &prices);
    if (s->paused) {
        advance_standing(d, s, &prices, &found);
    } else {
        advance_moving(d, s, &prices, &found);
    }
    s->least = found.metric;
    m->place = found.place;
    m->sum = found.metric;
    m->ties = found.ties;
    m->second = VPR_NONE;
    m->second_sum = VPR_NONE;
    const uint32_t right = found.place + d->exclusion + 1U;
    search_second(s->metric, 0U,
                  (found.place > d->exclusion) ? (found.place - d->exclusion) : 0U, m);
    search_second(s->metric, right, d->place_count, m);
    trust(d, s, m);
}

#endif
