/* The place filter: one metric a place, advanced in place, window by window. Part of vpr.c.
 *
 * Prices come with their fraction bits. No sum here is above 32 bits: distances have 16 and there
 * are as many places at most, metrics have 10 and prices less, the reciprocal has 17.
 */
#ifndef VPR_FILTER_H
#define VPR_FILTER_H

#include "sad.h"
#include "vpr.h"

#define METRIC_TOP 1023U
#define EVIDENCE_TOP 255U
#define EVIDENCE_SHIFT 14U /* fraction bits of the reciprocal, less those of a metric */
#define RECIPROCAL_ONE 0x10000U
#define TRUST_BITS 4U
#define TRUST_SHIFT 2U
#define PAUSE_STEPS 3U
#define STEPS_MAX 16U

/* What a step to a place costs, and the metrics above the present place before they changed. */
typedef struct {
    const uint16_t *price; /* forward from a step of 0 on, then back from -1 on */
    uint32_t steps;
    uint32_t back;
    uint32_t least; /* metric of the window before */
    uint32_t limit; /* what any place costs at most: a restart from the least */
    uint16_t ahead[STEPS_MAX];
} prices_t;

/* Of all places, after one window. */
typedef struct {
    uint32_t place;
    uint32_t metric;
    uint32_t ties;
} least_t;

/* Move a value by 1 / 2^shift of its difference to a target, rounded down. */
static uint32_t moved(uint32_t value, uint32_t target, uint32_t shift)
{
    if (target >= value) {
        return value + ((target - value) >> shift);
    }
    return value - (((value - target) + ((1U << shift) - 1U)) >> shift);
}

/* Divide, rounded down, a bit at a time: the smallest cores do it in a library. The divisor is
 * below 2^31. */
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

static inline uint32_t distance_to(const vpr_design_t *d, const vpr_state_t *s, uint32_t place)
{
    return d->keep_distances ? s->distance[place]
                             : sad(s->query, &d->places[place * d->stride], d->stride);
}

static inline uint32_t apart(uint32_t a, uint32_t b)
{
    return (a < b) ? (b - a) : (a - b);
}

/* The scale of the evidence, of the deviations' sum. */
static uint32_t reciprocal_of(const vpr_design_t *d, uint32_t deviations)
{
    const uint32_t spread = quotient(deviations, d->place_count);
    return quotient(RECIPROCAL_ONE, (spread == 0U) ? 1U : spread);
}

/* Price of the cheapest way to a place, from the metrics at and below it, which have not changed
 * yet, and from those above it, which have. */
static inline uint32_t predicted(const prices_t *p, const uint16_t *metric, uint32_t place,
                                 uint32_t above)
{
    uint32_t cheapest = p->limit;
    const uint32_t steps = (place < p->steps) ? (place + 1U) : p->steps;
    for (uint32_t i = 0U; i < steps; i++) {
        const uint32_t price = (uint32_t)metric[place - i] + p->price[i];
        cheapest = (price < cheapest) ? price : cheapest;
    }
    const uint32_t back = (above < p->back) ? above : p->back;
    for (uint32_t i = 0U; i < back; i++) {
        const uint32_t price = (uint32_t)p->ahead[i] + p->price[p->steps + i];
        cheapest = (price < cheapest) ? price : cheapest;
    }
    return cheapest - p->least;
}

/* Give a place its new metric. Places come from the last to the first, so that the lowest of equals
 * comes last. */
static inline void put_metric(prices_t *p, least_t *f, uint16_t *metric, uint32_t place,
                              uint32_t value)
{
    for (uint32_t i = p->back; i > 1U; i--) {
        p->ahead[i - 1U] = p->ahead[i - 2U];
    }
    if (p->back != 0U) {
        p->ahead[0] = metric[place];
    }
    metric[place] = (uint16_t)value;
    if (value <= f->metric) {
        f->ties = (value == f->metric) ? (f->ties + 1U) : 0U;
        f->metric = value;
        f->place = place;
    }
}

static void advance_standing(const vpr_design_t *d, vpr_state_t *s, prices_t *p, least_t *f)
{
    for (uint32_t place = d->place_count; place > 0U; place--) {
        put_metric(p, f, s->metric, place - 1U, predicted(p, s->metric, place - 1U, 0U));
    }
}

static void advance_moving(const vpr_design_t *d, vpr_state_t *s, prices_t *p, least_t *f)
{
    const uint32_t count = d->place_count;
    uint32_t total = 0U;
    uint32_t nearest = VPR_NONE;
    const uint8_t *codes = d->places;
    for (uint32_t place = 0U; place < count; place++) {
        const uint32_t distance = sad(s->query, codes, d->stride);
        codes = &codes[d->stride];
        total += distance;
        nearest = (distance < nearest) ? distance : nearest;
        if (d->keep_distances) {
            s->distance[place] = (uint16_t)distance;
        }
    }
    const uint32_t mean = quotient(total, count);
    if (s->reciprocal == 0U) { /* the first window's is its own */
        uint32_t own = 0U;
        for (uint32_t place = 0U; place < count; place++) {
            own += apart(distance_to(d, s, place), mean);
        }
        s->reciprocal = reciprocal_of(d, own);
    }
    const uint32_t reciprocal = s->reciprocal;
    uint32_t deviations = 0U;
    for (uint32_t place = count; place > 0U; place--) {
        const uint32_t at = place - 1U;
        const uint32_t distance = distance_to(d, s, at);
        const uint32_t scaled = ((distance - nearest) * reciprocal) >> EVIDENCE_SHIFT;
        const uint32_t evidence = (scaled < EVIDENCE_TOP) ? scaled : EVIDENCE_TOP;
        const uint32_t value = predicted(p, s->metric, at, count - place) + evidence;
        deviations += apart(distance, mean);
        put_metric(p, f, s->metric, at, (value < METRIC_TOP) ? value : METRIC_TOP);
    }
    s->reciprocal = reciprocal_of(d, deviations);
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
    s->trust = moved(follows ? s->trust : 0U, margin << TRUST_BITS, TRUST_SHIFT);
    s->place = m->place;
    m->trust = s->trust;
}

/* Advance by the window that ended last, and search it. */
static void filter_places(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m)
{
    static const uint16_t standing[PAUSE_STEPS] = {0U, 0U, 4U};
    least_t found = {0U, VPR_NONE, 0U};
    prices_t p;
    p.least = s->least;
    /* before the first window, each place is as likely as another */
    p.limit = (s->place == VPR_NONE) ? 0U : (s->least + d->restart);
    if (s->paused) {
        p.price = standing;
        p.steps = PAUSE_STEPS;
        p.back = 0U;
        advance_standing(d, s, &p, &found);
    } else {
        p.price = d->price;
        p.steps = d->steps;
        p.back = d->back;
        advance_moving(d, s, &p, &found);
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
