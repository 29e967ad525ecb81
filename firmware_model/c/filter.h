/* The place filter: a metric of each place and gain, advanced in place, window by window. Part of
 * vpr.c.
 *
 * Costs come with their fraction bits. No sum here is above 32 bits: distances have 16 and there
 * are as many places at most, metrics have 7 and costs no more, the reciprocal has 17.
 *
 * With one gain a metric is a byte; the seven gains of a place are the first bytes of two words, and
 * the last byte has the least of them between `best` and the next `predict`.
 */
#ifndef VPR_FILTER_H
#define VPR_FILTER_H

#include <stddef.h>

#include "lanes.h"
#include "quotient.h"
#include "sad.h"
#include "tables.h"
#include "vpr.h"

#define METRIC_TOP 127U
#define EVIDENCE_TOP 255U
#define EVIDENCE_SHIFT 14U /* fraction bits of the reciprocal, less those of a metric */
#define RECIPROCAL_ONE 0x10000U
#define TRUST_FRACTION_BITS 4U
#define TRUST_SHIFT 2U
#define MARGIN_TOP 23U
#define STANDING_SHIFT 3U
#define WHOLE_AGE 8U /* windows of a path after which its trust is whole */
#define AGE_SHIFT 3U
#define WEIGHT_BITS 3U
#define WEIGHT_TOP 8U
#define WEIGHT_FROM (-56) /* surplus of events, from which on evidence has weight */
#define FEW_BELOW (-48)   /* surplus of a window with few events */
#define PATIENCE 2U       /* after more such windows in a row, the robot stands */
#define GAIN_LOWEST (-32) /* the seven are half an octave apart */
#define GAIN_SHIFT 3U
#define GAIN_TOP 6U
#define GAIN_SAME 4U /* that of the reference, the only one of one */
#define GAIN_CHANGE 24U
#define LANES 8U /* of seven gains, with the least */
#define SUMS 3U  /* of the newest 1, 2 and 4 windows */
#define LANES_SHIFT 3U
#define LEAST_LANE 0x7F000000U /* above all, while it is none */
#define SPEED_SHIFT 6U
#define SPEED_BITS 4U
#define MOVED_TOP 63U
#define LOG_TOP 368
#define SLOW (-12) /* a mean speed below it: the sum of two windows */
#define SLOWEST (-28) /* below it: of four */
#define COST_ROW_SHIFT 3U
#define COST_ORIGIN 132 /* 16 rows lie below that of the same activity; half a row rounds */
#define NEAR 8U  /* metrics of places near the best */
#define REACH 4U /* such places on each side, of half windows */

/* What the number of events of a window says. */
typedef struct {
    uint32_t weight;     /* of its evidence, in eighths */
    int32_t activity;    /* so that it gives the costs of a place; the lowest if the robot stands */
    uint32_t sum[LANES]; /* that each gain looks at: 0, 1 or 2 */
} seen_t;

/* Statistics of the distances of a sum. */
typedef struct {
    uint32_t nearest;
    uint32_t reciprocal; /* by which the evidence is scaled; 0: there is none */
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

/* 1. What the number of events says. */

/* Log2 of a gain, in 1/16 octave. */
static int32_t gain_of(uint32_t h)
{
    return GAIN_LOWEST + (int32_t)(h << GAIN_SHIFT);
}

/* The mean speed of the drive, by windows that have not few events. */
static void move_speed(vpr_state_t *s)
{
    uint32_t shift = 0U;
    while ((shift < SPEED_SHIFT) && (((s->moved + 1U) >> (shift + 1U)) > 0U)) {
        shift++;
    }
    s->speed = moved(s->speed, (uint32_t)(s->activity + LOG_TOP) << SPEED_BITS, shift);
    s->moved = lesser(s->moved + 1U, MOVED_TOP);
}

/* Which sum a gain looks at: the slower the drive by it, the longer. */
static uint32_t which_sum(const vpr_state_t *s, uint32_t h)
{
    const int32_t mean = (int32_t)(s->speed >> SPEED_BITS) - LOG_TOP - gain_of(h);
    return ((mean < SLOW) ? 1U : 0U) + ((mean < SLOWEST) ? 1U : 0U);
}

static void see(const vpr_design_t *d, vpr_state_t *s, seen_t *seen)
{
    bool few = s->paused;
    seen->weight = WEIGHT_TOP;
    if (s->place != VPR_NONE) {
        const int32_t gain = gain_of(s->gain);
        const int32_t surplus =
            s->activity - d->place_activity[s->place] - ((gain < 0) ? gain : 0);
        const int32_t above = surplus - WEIGHT_FROM;
        seen->weight = (above > 0) ? lesser((uint32_t)above >> 1, WEIGHT_TOP) : 0U;
        few = few || (surplus < FEW_BELOW);
    }
    s->few = few ? lesser(s->few + 1U, PATIENCE + 1U) : 0U;
    seen->activity = (s->few > PATIENCE) ? (-4 * LOG_TOP) : s->activity;
    if ((d->gains > 1U) && !few) {
        move_speed(s);
    }
    for (uint32_t h = 0U; h < LANES; h++) {
        seen->sum[h] = (d->gains > 1U) ? which_sum(s, h) : 0U;
    }
}

/* 2. The prediction takes the place of the metrics, from the last place to the first: steps lead from
 * lower places, which have not changed by then. */

/* Where the costs of the steps to a place begin, of the lowest gain; those of the others follow. */
static inline uint32_t costs_of(int32_t activity, int32_t of_place)
{
    const int32_t above = activity - of_place + COST_ORIGIN;
    const uint32_t row = (above > 0) ? ((uint32_t)above >> COST_ROW_SHIFT) : 0U;
    return (COLUMNS - LANES) - lesser(row, COLUMNS - LANES);
}

static const uint8_t *costs_by(const vpr_design_t *d)
{
    return (d->steps == STEPS) ? whole_costs : half_costs;
}

/* With one gain, places from the fifth on at whole windows: metrics stay in registers. */
static void predict_whole(const vpr_design_t *d, vpr_state_t *s, int32_t activity, uint32_t limit)
{
    uint8_t *const metric = s->metric;
    const uint32_t least = s->least;
    const uint32_t end = d->place_count;
    const uint32_t most = limit + least;
    uint32_t here = metric[end - 1U];
    uint32_t one = metric[end - 2U];
    uint32_t two = metric[end - 3U];
    uint32_t three = metric[end - 4U];
    for (uint32_t at = end - 1U; at >= (STEPS - 1U); at--) {
        const uint8_t *const cost =
            &whole_costs[costs_of(activity, d->place_activity[at]) + GAIN_SAME];
        const uint32_t four_below = metric[at - 4U];
        uint32_t path = lesser(lesser(most, here + cost[0]), one + cost[COLUMNS]);
        path = lesser(lesser(path, two + cost[2U * COLUMNS]), three + cost[3U * COLUMNS]);
        path = lesser(path, four_below + cost[4U * COLUMNS]);
        metric[at] = (uint8_t)(path - least);
        here = one;
        one = two;
        two = three;
        three = four_below;
    }
}

/* With one gain. A restart is below the largest metric, and so is what is predicted. */
static void predict_one(const vpr_design_t *d, vpr_state_t *s, int32_t activity, uint32_t limit)
{
    const uint8_t *const costs = costs_by(d);
    uint32_t end = d->place_count;
    if ((d->steps == STEPS) && (end >= STEPS)) {
        predict_whole(d, s, activity, limit);
        end = STEPS - 1U;
    }
    while (end > 0U) {
        end--;
        const uint8_t *cost = &costs[costs_of(activity, d->place_activity[end]) + GAIN_SAME];
        const uint32_t steps = lesser(d->steps, end + 1U);
        uint32_t path = limit + s->least;
        for (uint32_t i = 0U; i < steps; i++) {
            path = lesser(path, s->metric[end - i] + (uint32_t)cost[0]);
            cost = &cost[COLUMNS];
        }
        s->metric[end] = (uint8_t)(path - s->least);
    }
}

/* Take changes by so many gains, to higher ones and then to lower ones, of 1 or 2: `low` has the four
 * lower gains. A lane without a gain beside it has LANE_TOP there, which is no less than any. */
static inline void change(uint32_t *low, uint32_t *high, uint32_t gains)
{
    const uint32_t bits = 8U * gains;
    const uint32_t rest = 32U - bits;
    const uint32_t none = EACH * LANE_TOP;
    const uint32_t cost = EACH * (GAIN_CHANGE * gains);
    const uint32_t above = lesser_each(
        *high, added_each((*high << bits) | (*low >> rest), cost)) | LEAST_LANE;
    const uint32_t below = lesser_each(*low, added_each((*low << bits) | (none >> rest), cost));
    *low = lesser_each(below, added_each((below >> bits) | (above << rest), cost));
    *high = lesser_each(above, added_each((above >> bits) | (none << rest), cost));
}

/* The same by four gains. */
static inline void change_by_four(uint32_t *low, uint32_t *high)
{
    const uint32_t cost = EACH * (GAIN_CHANGE * 4U);
    const uint32_t above = lesser_each(*high, added_each(*low, cost)) | LEAST_LANE;
    *low = lesser_each(*low, added_each(above, cost));
    *high = above;
}

/* Metrics of all gains less the least of all, after changes of gain; the least of each in `low` and
 * `high`. */
static void change_gain(const vpr_design_t *d, vpr_state_t *s, uint32_t *low, uint32_t *high)
{
    const uint32_t least = EACH * s->least;
    uint32_t *metric = s->bank;
    *low = EACH * LANE_TOP;
    *high = EACH * LANE_TOP;
    for (uint32_t place = 0U; place < d->place_count; place++) {
        uint32_t l = metric[0] - least;
        uint32_t h = (metric[1] - least) | LEAST_LANE;
        change(&l, &h, 1U);
        change(&l, &h, 2U);
        change_by_four(&l, &h);
        metric[0] = l;
        metric[1] = h;
        *low = lesser_each(*low, l);
        *high = lesser_each(*high, h);
        metric = &metric[2];
    }
}

/* With seven gains: four at once. */
static void predict_bank(const vpr_design_t *d, vpr_state_t *s, int32_t activity, uint32_t limit)
{
    const uint8_t *const costs = costs_by(d);
    uint32_t low;
    uint32_t high;
    change_gain(d, s, &low, &high);
    const uint32_t most_low = added_each(low, EACH * limit);
    const uint32_t most_high = added_each(high, EACH * limit);
    for (uint32_t place = d->place_count; place > 0U; place--) {
        const uint32_t steps = lesser(d->steps, place);
        uint32_t *const metric = &s->bank[2U * (place - 1U)];
        const uint32_t *from = metric;
        const uint8_t *cost = &costs[costs_of(activity, d->place_activity[place - 1U])];
        low = most_low;
        high = most_high;
        for (uint32_t i = 0U; i < steps; i++) {
            low = lesser_each(low, added_each(from[0], four(cost)));
            high = lesser_each(high, added_each(from[1], four(&cost[4])));
            from = &from[-2];
            cost = &cost[COLUMNS];
        }
        metric[0] = low;
        metric[1] = high;
    }
}

static void predict(const vpr_design_t *d, vpr_state_t *s, const seen_t *seen)
{
    /* before the first window, each place is as likely as another */
    const uint32_t limit = (s->place == VPR_NONE) ? 0U : d->restart;
    if (d->gains > 1U) {
        predict_bank(d, s, seen->activity, limit);
    } else {
        predict_one(d, s, seen->activity, limit);
    }
}

/* 3. The evidence. */

static inline uint32_t evidence_of(const scale_t *scale, uint32_t distance, uint32_t weight)
{
    const uint32_t scaled = ((distance - scale->nearest) * scale->reciprocal) >> EVIDENCE_SHIFT;
    return (lesser(scaled, EVIDENCE_TOP) * weight) >> WEIGHT_BITS;
}

/* The distance of a sum to a place, with the bias of the place. */
static uint32_t distance_to(const vpr_design_t *d, const vpr_state_t *s, uint32_t sum,
                            uint32_t place)
{
    return sad(&s->query[sum * d->stride], &d->places[place * d->stride], d->stride) +
           d->place_bias[place];
}

/* Keep the distances of a sum to all places; their sum, and the least of them. */
static uint32_t compare(const vpr_design_t *d, vpr_state_t *s, uint32_t sum, uint32_t *nearest)
{
    uint32_t least = VPR_NONE;
    uint32_t total = 0U;
    for (uint32_t i = 0U; i < d->place_count; i++) {
        const uint32_t distance = distance_to(d, s, sum, i);
        s->distance[i] = (uint16_t)distance;
        total += distance;
        least = lesser(least, distance);
    }
    *nearest = least;
    return total;
}

static inline uint32_t deviation(uint32_t distance, uint32_t mean)
{
    return (distance < mean) ? (mean - distance) : (distance - mean);
}

/* The reciprocal of the spread of the distances. */
static uint32_t reciprocal_of(const vpr_design_t *d, const vpr_state_t *s, uint32_t mean)
{
    uint32_t deviations = 0U;
    for (uint32_t i = 0U; i < d->place_count; i++) {
        deviations += deviation(s->distance[i], mean);
    }
    const uint32_t spread = quotient(deviations, d->place_count);
    return quotient(RECIPROCAL_ONE, (spread == 0U) ? 1U : spread);
}

/* Add the evidence of a sum to the metrics of one gain. */
static void add_one(const vpr_design_t *d, vpr_state_t *s, const scale_t *scale, uint32_t weight)
{
    for (uint32_t i = 0U; i < d->place_count; i++) {
        const uint32_t against = evidence_of(scale, s->distance[i], weight);
        s->metric[i] = (uint8_t)lesser(s->metric[i] + against, METRIC_TOP);
    }
}

/* Add the evidence of a sum to the metrics of the gains that look at it. */
static void add_bank(const vpr_design_t *d, vpr_state_t *s, const scale_t *scale,
                     const seen_t *seen, uint32_t sum)
{
    uint32_t looks[2] = {0U, 0U};
    for (uint32_t h = 0U; h < LANES; h++) {
        looks[h / 4U] |= (seen->sum[h] == sum) ? ((uint32_t)0xFFU << (8U * (h % 4U))) : 0U;
    }
    uint32_t *metric = s->bank;
    for (uint32_t i = 0U; i < d->place_count; i++) {
        const uint32_t against =
            EACH * lesser(evidence_of(scale, s->distance[i], seen->weight), METRIC_TOP);
        metric[0] = added_each(metric[0], against & looks[0]);
        metric[1] = added_each(metric[1], against & looks[1]);
        metric = &metric[2];
    }
}

/* Add the evidence of a sum. It is scaled by the spread of the window before, if that had one. */
static void evidence(const vpr_design_t *d, vpr_state_t *s, const seen_t *seen, uint32_t sum,
                     scale_t *scale)
{
    const uint32_t total = compare(d, s, sum, &scale->nearest);
    const uint32_t own = reciprocal_of(d, s, quotient(total, d->place_count));
    scale->reciprocal = (s->reciprocal[sum] != 0U) ? s->reciprocal[sum] : own;
    s->reciprocal[sum] = own;
    if (d->gains > 1U) {
        add_bank(d, s, scale, seen, sum);
    } else {
        add_one(d, s, scale, seen->weight);
    }
}

/* Whether some gain looks at a sum. */
static bool looked_at(const vpr_design_t *d, const seen_t *seen, uint32_t sum)
{
    bool looked = false;
    for (uint32_t h = 0U; h < d->gains; h++) {
        looked = looked || (seen->sum[h] == sum);
    }
    return looked;
}

/* 4. The best place, and the middle of the places near it. */

/* Write the least metric of each place into its last lane, of seven gains. */
static void write_least(const vpr_design_t *d, vpr_state_t *s)
{
    uint32_t *metric = s->bank;
    for (uint32_t i = 0U; i < d->place_count; i++) {
        const uint32_t high = metric[1] | LEAST_LANE;
        uint32_t least = lesser_each(metric[0], high);
        least = lesser_each(least, least >> 16);
        least = lesser_each(least, least >> 8) & 0xFFU;
        metric[1] = (high & ~LEAST_LANE) | (least << 24);
        metric = &metric[2];
    }
}

/* The least metric of some places, into the second best: ties to the lowest place. */
static void search_second(const vpr_design_t *d, const uint8_t *metric, uint32_t from,
                          uint32_t end, vpr_match_t *m)
{
    uint32_t least = m->second_sum;
    for (uint32_t place = from; place < end; place++) {
        const uint32_t value = metric[place << d->lane_shift];
        if (value < least) {
            least = value;
            m->second = place;
        }
    }
    m->second_sum = least;
}

/* The middle of the places around the best whose metric is near its own. */
static uint32_t middle(const vpr_design_t *d, const uint8_t *metric, uint32_t place)
{
    const uint32_t reach = (d->steps == STEPS) ? 0U : REACH;
    const uint32_t near = metric[place << d->lane_shift] + NEAR;
    const uint32_t lowest = (place > reach) ? (place - reach) : 0U;
    const uint32_t highest = lesser(place + reach, d->place_count - 1U);
    uint32_t first = place;
    uint32_t last = place;
    while ((first > lowest) && (metric[(first - 1U) << d->lane_shift] <= near)) {
        first--;
    }
    while ((last < highest) && (metric[(last + 1U) << d->lane_shift] <= near)) {
        last++;
    }
    return (first + last + 1U) >> 1;
}

/* The lowest place of the least metric, how many others have it, the second best, and what is told.
 * Returns the best place. */
static uint32_t best(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m)
{
    const uint8_t *metric = s->metric;
    if (d->gains > 1U) {
        write_least(d, s);
        metric = &metric[LANES - 1U];
    }
    uint32_t place = 0U;
    uint32_t least = VPR_NONE;
    uint32_t ties = 0U;
    for (uint32_t i = 0U; i < d->place_count; i++) {
        const uint32_t value = metric[i << d->lane_shift];
        if (value < least) {
            least = value;
            place = i;
            ties = 0U;
        } else if (value == least) {
            ties++;
        } else {
            /* neither */
        }
    }
    m->place = middle(d, metric, place);
    m->sum = least;
    m->ties = ties;
    m->second = VPR_NONE;
    m->second_sum = VPR_NONE;
    search_second(d, metric, 0U, (place > d->exclusion) ? (place - d->exclusion) : 0U, m);
    search_second(d, metric, place + d->exclusion + 1U, d->place_count, m);
    s->least = least;
    s->gain = GAIN_SAME;
    if (d->gains > 1U) {
        s->gain = 0U;
        while ((s->gain < GAIN_TOP) && (s->metric[(place << LANES_SHIFT) + s->gain] != least)) {
            s->gain++;
        }
    }
    return place;
}

/* 5. The trust in the match: by its margin, and by those before it as long as it follows from them;
 * less what speaks against it and the two matches before. The specification limits the residual to
 * 23, which leaves no trust: any larger number does the same. */
static void trust(const vpr_design_t *d, vpr_state_t *s, uint32_t place, uint32_t residual,
                  vpr_match_t *m)
{
    const uint32_t margin = (m->second == VPR_NONE) ? METRIC_TOP : (m->second_sum - m->sum);
    const bool follows = (s->place != VPR_NONE) && ((place - s->place) < d->steps);
    const uint32_t kept = follows ? s->support : 0U;
    s->age = follows ? lesser(s->age + 1U, WHOLE_AGE) : 0U;
    s->support = moved(kept, lesser(margin, MARGIN_TOP) << TRUST_FRACTION_BITS, TRUST_SHIFT);
    if (place == s->place) {
        /* repeated views add no information */
        s->support = lesser(s->support, kept - (kept >> STANDING_SHIFT));
    }
    s->place = place;
    uint32_t worst = (s->residual > s->residual_before) ? s->residual : s->residual_before;
    worst = ((residual > worst) ? residual : worst) << TRUST_FRACTION_BITS;
    m->trust = ((s->support - lesser(s->support, worst)) * s->age) >> AGE_SHIFT;
    s->residual_before = s->residual;
    s->residual = residual;
}

/* Advance by the window that ended last, and match it. */
static void filter_places(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m)
{
    seen_t seen;
    scale_t scale[SUMS] = {{0U, 0U}, {0U, 0U}, {0U, 0U}};
    see(d, s, &seen);
    predict(d, s, &seen);
    for (uint32_t sum = 0U; (sum < SUMS) && !s->paused; sum++) {
        if (looked_at(d, &seen, sum)) {
            evidence(d, s, &seen, sum, &scale[sum]);
        } else {
            s->reciprocal[sum] = 0U;
        }
    }
    const uint32_t place = best(d, s, m);
    const uint32_t sum = seen.sum[s->gain];
    trust(d, s, place,
          s->paused ? 0U : evidence_of(&scale[sum], distance_to(d, s, sum, place), seen.weight), m);
}

#endif
