#include "plain.h"

#include <stdio.h>
#include <stdlib.h>

/* Words of the header, again: not those of vpr.c, which are under test. */
enum {
    BYTES = 2,
    SLOTS = 6,
    STRIDE = 7,
    COUNT_MAX = 8,
    PLACES = 9,
    LENGTH = 10,
    EXCLUSION = 11,
    WINDOW_KIND = 12,
    WINDOW = 13,
    TIMESTAMP_BITS = 14,
    ACCEPT = 15,
    RATIO_DENOMINATOR = 16,
    DEPTH = 17,
    LOOKUP = 21,
    CODES = 22,
    WHICH_CODES = 23,
    MAP = 24,
    COSTS = 25,
    MEANS = 26,
    PLACE_ACTIVITY = 27,
    STEPS = 28,
    BACK = 29,
    RESTART = 30,
    TRUST = 32,
    OWN_MEAN = 33,
    ACTIVITY = 34,
    CONTRAST = 35,
    ACTIVITY_COSTS = 36
};

/* Costs of a step of 0 to 3 places, a row each half octave of activity. */
static const uint8_t by_activity[17][4] = {
    {4, 24, 47, 71}, {4, 22, 43, 66}, {4, 20, 39, 61}, {4, 17, 36, 57}, {4, 15, 32, 52},
    {4, 12, 28, 48}, {4, 10, 24, 43}, {4, 7, 20, 38},  {4, 5, 17, 34},  {4, 3, 13, 30},
    {5, 1, 10, 26},  {7, 0, 8, 22},   {9, 0, 6, 20},   {11, 0, 5, 18},  {15, 1, 5, 17},
    {19, 3, 5, 16},  {22, 4, 4, 15}};

/* The same of a step of 0 to 6 places, if there are two per window. */
static const uint8_t at_half_windows[17][7] = {
    {4, 17, 44, 63, 80, 107, 120}, {4, 15, 39, 57, 73, 100, 111}, {4, 14, 35, 51, 67, 92, 103},
    {4, 12, 31, 45, 60, 84, 95},   {4, 10, 26, 40, 53, 77, 87},   {4, 8, 22, 34, 46, 69, 79},
    {4, 6, 18, 28, 40, 62, 70},    {4, 4, 14, 22, 33, 54, 62},    {5, 3, 10, 17, 27, 47, 55},
    {5, 1, 6, 11, 20, 40, 46},     {6, 1, 2, 7, 14, 33, 39},      {8, 1, 1, 4, 10, 28, 34},
    {12, 3, 0, 2, 7, 24, 29},      {17, 6, 1, 1, 5, 22, 26},      {23, 11, 2, 1, 4, 20, 24},
    {30, 16, 6, 3, 5, 20, 23},     {37, 21, 8, 4, 5, 20, 22}};

static uint32_t byte_at(const plain_t *p, uint64_t at)
{
    if (at >= p->bytes) {
        (void)fprintf(stderr, "plain: the image ends before byte %llu\n", (unsigned long long)at);
        abort();
    }
    return p->image[at];
}

static uint32_t word_at(const plain_t *p, uint64_t at)
{
    return byte_at(p, at) | (byte_at(p, at + 1U) << 8) | (byte_at(p, at + 2U) << 16) |
           (byte_at(p, at + 3U) << 24);
}

static uint32_t half_at(const plain_t *p, uint64_t at)
{
    return byte_at(p, at) | (byte_at(p, at + 1U) << 8);
}

/* Divide by a power of two, rounded down, also what is negative. */
static int64_t floor_shift(int64_t value, uint32_t shift)
{
    const int64_t divisor = (int64_t)1 << shift;
    const int64_t rest = ((value % divisor) + divisor) % divisor;
    return (value - rest) / divisor;
}

uint32_t plain_word(const plain_t *p, uint32_t word)
{
    return word_at(p, (uint64_t)word * 4U);
}

static uint64_t period(const plain_t *p)
{
    return (uint64_t)1U << plain_word(p, TIMESTAMP_BITS);
}

void plain_begin(plain_t *p, const uint8_t *image, uint32_t bytes, uint32_t start)
{
    p->image = image;
    p->bytes = bytes;
    const uint32_t slots = plain_word(p, SLOTS);
    p->counts = calloc(slots, sizeof *p->counts);
    p->codes = calloc(slots, PLAIN_WINDOWS);
    if ((p->counts == NULL) || (p->codes == NULL)) {
        abort();
    }
    const uint32_t places = plain_word(p, PLACES);
    p->mean = calloc(slots, sizeof *p->mean);
    p->metric = calloc(places, sizeof *p->metric);
    p->evidence = calloc(places, sizeof *p->evidence);
    if ((p->mean == NULL) || (p->metric == NULL) || (p->evidence == NULL)) {
        abort();
    }
    for (uint32_t i = 0U; (i < slots) && (plain_word(p, OWN_MEAN) != 0U); i++) {
        p->mean[i] = (int64_t)half_at(p, plain_word(p, MEANS) + ((uint64_t)i * 2U)) * 256;
    }
    p->usual = plain_word(p, ACTIVITY);
    p->activity = 0;
    p->paused = false;
    p->moved = 0U;
    p->reciprocal = 0;
    p->place = -1;
    p->support = 0;
    p->residuals[0] = 0;
    p->residuals[1] = 0;
    p->end = (start + (uint64_t)plain_word(p, WINDOW)) % period(p);
    p->counted = 0U;
    p->windows = 0U;
}

void plain_free(plain_t *p)
{
    free(p->counts);
    free(p->codes);
    free(p->mean);
    free(p->metric);
    free(p->evidence);
}

bool plain_is_behind(const plain_t *p, const vpr_event_t *e)
{
    if (plain_word(p, WINDOW_KIND) != 0U) {
        return false;
    }
    /* what is left is 1 to half a period, or it is nothing or less */
    const uint64_t left = (p->end + period(p) - (e->t % period(p))) % period(p);
    return (left == 0U) || (left >= (period(p) / 2U));
}

bool plain_is_full(const plain_t *p)
{
    return (plain_word(p, WINDOW_KIND) != 0U) && (p->counted == plain_word(p, WINDOW));
}

uint32_t plain_take(plain_t *p, const vpr_event_t *e)
{
    const uint32_t pixel = e->pixel & 0x7FFFFFFFU;
    const uint32_t depth = plain_word(p, DEPTH);
    for (uint32_t i = 0U; i < depth; i++) {
        const uint64_t at = plain_word(p, LOOKUP) + (uint64_t)i * 8U;
        if (word_at(p, at) != pixel) {
            continue;
        }
        const uint64_t slot_at = at + (((e->pixel >> 31) != 0U) ? 6U : 4U);
        const uint32_t slot = byte_at(p, slot_at) | (byte_at(p, slot_at + 1U) << 8);
        if (slot >= plain_word(p, SLOTS)) {
            (void)fprintf(stderr, "plain: slot %u\n", (unsigned)slot);
            abort();
        }
        p->counts[slot] += (p->counts[slot] < plain_word(p, COUNT_MAX)) ? 1U : 0U;
        p->counted++;
        return slot;
    }
    return VPR_NONE;
}

static int64_t level_of(const plain_t *p, uint32_t slot)
{
    return half_at(p, plain_word(p, CODES) + ((uint64_t)p->counts[slot] * 2U));
}

/* What is subtracted from each logarithm of the window. */
static int64_t window_mean(const plain_t *p)
{
    const int64_t slots = plain_word(p, SLOTS);
    int64_t sum = 0;
    for (uint32_t slot = 0U; slot < slots; slot++) {
        sum += level_of(p, slot) - floor_shift(p->mean[slot] + 128, 8U);
    }
    int64_t mean = 0;
    while ((((2 * mean) + 1) * slots) <= (2 * sum)) {
        mean++;
    }
    while ((((2 * mean) - 1) * slots) > (2 * sum)) {
        mean--;
    }
    return (plain_word(p, CONTRAST) != 0U) ? mean : 0;
}

static uint8_t own_mean_code(plain_t *p, uint32_t slot, int64_t of_window)
{
    const int64_t level = level_of(p, slot);
    const int64_t half = (int64_t)1 << (plain_word(p, OWN_MEAN) - 1U);
    const int64_t mean = floor_shift(p->mean[slot] + 128, 8U);
    int64_t octaves = floor_shift(level - mean - of_window + 128, 8U);
    octaves = (octaves < -half) ? -half : octaves;
    octaves = (octaves > (half - 1)) ? (half - 1) : octaves;
    uint32_t shift = 8U;
    while ((16U + p->moved) < (1U << shift)) {
        shift--;
    }
    if (!p->paused) {
        p->mean[slot] += floor_shift((level * 256) - p->mean[slot], shift);
    }
    return (uint8_t)(octaves + half);
}

/* How often 2^(1/16) is in a number and 1: a bit of the logarithm with each square. */
static int64_t sixteenths(int64_t number)
{
    uint32_t octaves = 0U;
    while (((number + 1) >> (octaves + 1U)) != 0) {
        octaves++;
    }
    /* 63 bits of mantissa, which is not near enough to a root of 2 for its rounding to matter */
    uint64_t mantissa = (uint64_t)(number + 1) << (63U - octaves);
    int64_t found = octaves;
    for (uint32_t bit = 0U; bit < 4U; bit++) {
        const uint64_t high = mantissa >> 32;
        const uint64_t low = mantissa & 0xFFFFFFFFU;
        const uint64_t square = (high * high) + ((high * low) >> 31);
        found *= 2;
        if ((square >> 63) != 0U) {
            found++;
            mantissa = square;
        } else {
            mantissa = square << 1;
        }
    }
    return found;
}

const uint8_t *plain_window_end(plain_t *p)
{
    const int64_t events = (p->counted < 0x7FFFFFU) ? p->counted : 0x7FFFFF;
    p->activity = (events == 0) ? -368 : (sixteenths(events) - sixteenths(p->usual / 256));
    p->paused = (events == 0) || ((events * 16 * 256) < p->usual);
    const uint32_t slots = plain_word(p, SLOTS);
    uint8_t *const codes = &p->codes[(size_t)p->windows * slots];
    const uint64_t entries = (uint64_t)plain_word(p, COUNT_MAX) + 1U;
    const int64_t of_window = (plain_word(p, OWN_MEAN) != 0U) ? window_mean(p) : 0;
    for (uint32_t slot = 0U; slot < slots; slot++) {
        const uint64_t table = byte_at(p, (uint64_t)plain_word(p, WHICH_CODES) + slot);
        codes[slot] =
            (plain_word(p, OWN_MEAN) != 0U)
                ? own_mean_code(p, slot, of_window)
                : (uint8_t)byte_at(p, plain_word(p, CODES) + table * entries + p->counts[slot]);
        p->counts[slot] = 0U;
    }
    p->usual += floor_shift((events * 256) - p->usual, 6U);
    p->moved += p->paused ? 0U : 1U;
    p->end = (p->end + plain_word(p, WINDOW)) % period(p);
    p->counted = 0U;
    p->windows++;
    return codes;
}

static uint64_t distance(const plain_t *p, uint32_t window, uint32_t place)
{
    const uint32_t slots = plain_word(p, SLOTS);
    const uint64_t row = plain_word(p, MAP) + (uint64_t)place * plain_word(p, STRIDE);
    uint64_t sum = 0U;
    for (uint32_t slot = 0U; slot < slots; slot++) {
        sum += (uint64_t)abs((int)p->codes[(size_t)window * slots + slot] -
                             (int)byte_at(p, row + slot));
    }
    return sum;
}

static uint64_t sequence(const plain_t *p, uint32_t place)
{
    uint64_t sum = 0U;
    for (uint32_t ago = 0U; ago < plain_word(p, LENGTH); ago++) {
        sum += distance(p, p->windows - 1U - ago, place - ago);
    }
    return sum;
}

/* Scale of the evidence, of the mean absolute deviation of the distances. */
static int64_t reciprocal_of(const int64_t *distances, uint32_t places)
{
    int64_t total = 0;
    int64_t deviations = 0;
    for (uint32_t k = 0U; k < places; k++) {
        total += distances[k];
    }
    for (uint32_t k = 0U; k < places; k++) {
        deviations += llabs(distances[k] - (total / places));
    }
    const int64_t spread = deviations / places;
    return 65536 / ((spread < 1) ? 1 : spread);
}

static int64_t steps_of(const plain_t *p)
{
    const int64_t steps[3] = {plain_word(p, STEPS), 4, 7};
    return steps[plain_word(p, ACTIVITY_COSTS)];
}

/* Cost of a step forwards, 0 or more, that leads to a place. */
static int64_t forwards(const plain_t *p, int64_t step, uint32_t place)
{
    const uint32_t places_per_window = plain_word(p, ACTIVITY_COSTS);
    if (places_per_window == 0U) {
        return half_at(p, plain_word(p, COSTS) + ((uint64_t)step * 2U));
    }
    const int64_t byte = byte_at(p, (uint64_t)plain_word(p, PLACE_ACTIVITY) + place);
    int64_t row = 12 + floor_shift(p->activity - ((byte < 128) ? byte : (byte - 256)) + 4, 3U);
    row = (row < 0) ? 0 : row;
    row = (row > 16) ? 16 : row;
    return (places_per_window == 1U) ? by_activity[row][step] : at_half_windows[row][step];
}

/* Cost of being at a place, without the evidence. */
static int64_t predicted(const plain_t *p, const int64_t *metric, int64_t least, uint32_t place)
{
    const int64_t back = plain_word(p, BACK);
    int64_t cheapest = plain_word(p, RESTART);
    for (int64_t step = -back; step < steps_of(p); step++) {
        const int64_t from = (int64_t)place - step;
        const uint64_t at = ((uint64_t)plain_word(p, STEPS) - 1U - (uint64_t)step) * 2U;
        const int64_t cost = (step < 0) ? (int64_t)half_at(p, plain_word(p, COSTS) + at)
                                         : forwards(p, step, place);
        if ((from >= 0) && (from < (int64_t)plain_word(p, PLACES)) &&
            ((metric[from] - least + cost) < cheapest)) {
            cheapest = metric[from] - least + cost;
        }
    }
    return (p->place < 0) ? 0 : cheapest;
}

static void advance(plain_t *p)
{
    const uint32_t places = plain_word(p, PLACES);
    int64_t *const before = calloc(places, sizeof *before);
    int64_t *const distances = calloc(places, sizeof *distances);
    if ((before == NULL) || (distances == NULL)) {
        abort();
    }
    int64_t least = p->metric[0];
    int64_t nearest = INT64_MAX;
    for (uint32_t k = 0U; k < places; k++) {
        before[k] = p->metric[k];
        least = (before[k] < least) ? before[k] : least;
        distances[k] = (int64_t)distance(p, p->windows - 1U, k);
        nearest = (distances[k] < nearest) ? distances[k] : nearest;
    }
    int64_t weight = floor_shift(p->activity + 48, 1U);
    weight = (weight < 0) ? 0 : weight;
    weight = (weight > 8) ? 8 : weight;
    const int64_t own = reciprocal_of(distances, places);
    const int64_t reciprocal = (p->reciprocal == 0) ? own : p->reciprocal;
    for (uint32_t k = 0U; k < places; k++) {
        int64_t evidence = ((distances[k] - nearest) * reciprocal) / 16384;
        evidence = (((evidence > 255) ? 255 : evidence) * weight) / 8;
        p->evidence[k] = p->paused ? 0 : evidence;
        p->metric[k] = predicted(p, before, least, k) + p->evidence[k];
        p->metric[k] = (p->metric[k] > 1023) ? 1023 : p->metric[k];
    }
    p->reciprocal = p->paused ? p->reciprocal : own;
    free(before);
    free(distances);
}

/* What the match before says of this one. */
static void trust(plain_t *p, vpr_match_t *m)
{
    const int64_t forward = (steps_of(p) > 3) ? steps_of(p) : 3;
    const int64_t margin =
        (m->second == VPR_NONE) ? 1023 : ((int64_t)m->second_sum - (int64_t)m->sum);
    const int64_t step = (int64_t)m->place - p->place;
    if ((p->place < 0) || (step >= forward) || (step < -(int64_t)plain_word(p, BACK))) {
        p->support = 0;
    }
    const int64_t stood = p->support - (p->support / 16);
    p->support += floor_shift((((margin > 23) ? 23 : margin) * 16) - p->support, 2U);
    if ((step == 0) && (p->place >= 0) && (p->support > stood)) {
        p->support = stood;
    }
    p->place = m->place;
    p->residuals[2] = p->residuals[1];
    p->residuals[1] = p->residuals[0];
    p->residuals[0] = p->evidence[m->place];
    int64_t trust = p->support;
    for (uint32_t i = 0U; i < 3U; i++) {
        const int64_t less = p->support - (p->residuals[i] * 16);
        trust = (less < trust) ? less : trust;
    }
    m->trust = (trust < 0) ? 0U : (uint32_t)trust;
    m->accepted = m->accepted && (m->trust >= plain_word(p, TRUST));
}

bool plain_match(plain_t *p, vpr_match_t *m)
{
    const bool filters = steps_of(p) != 0;
    if (filters) {
        advance(p);
    }
    const uint32_t length = plain_word(p, LENGTH);
    const uint32_t places = plain_word(p, PLACES);
    if (p->windows < length) {
        return false;
    }
    uint64_t *const sums = calloc(places, sizeof *sums);
    if (sums == NULL) {
        abort();
    }
    uint32_t best = length - 1U;
    for (uint32_t k = length - 1U; k < places; k++) {
        sums[k] = filters ? (uint64_t)p->metric[k] : sequence(p, k);
        best = (sums[k] < sums[best]) ? k : best;
    }
    uint32_t second = VPR_NONE;
    m->ties = 0U;
    for (uint32_t k = length - 1U; k < places; k++) {
        const uint32_t apart = (k > best) ? (k - best) : (best - k);
        m->ties += ((k != best) && (sums[k] == sums[best])) ? 1U : 0U;
        if ((apart > plain_word(p, EXCLUSION)) &&
            ((second == VPR_NONE) || (sums[k] < sums[second]))) {
            second = k;
        }
    }
    const uint64_t denominator = plain_word(p, RATIO_DENOMINATOR);
    const uint64_t accept = plain_word(p, ACCEPT);
    m->window = p->windows - 1U;
    m->place = best;
    m->sum = (uint32_t)sums[best];
    m->second = second;
    m->second_sum = (second == VPR_NONE) ? VPR_NONE : (uint32_t)sums[second];
    if (second == VPR_NONE) {
        m->accepted = false;
    } else if (denominator == 0U) {
        m->accepted = (sums[second] - sums[best]) >= accept;
    } else {
        m->accepted =
            (sums[second] > 0U) && ((sums[best] * denominator) <= (sums[second] * accept));
    }
    free(sums);
    m->trust = 0U;
    if (filters) {
        trust(p, m);
    }
    return true;
}
