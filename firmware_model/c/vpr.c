#include "vpr.h"

#include <stddef.h>

#include "crc.h"
#include "filter.h"
#include "sad.h"
#include "tables.h"

#define LIMIT 0xFFFFU     /* of what is multiplied */
#define HALF_PERIOD 0x80000000U /* of the scaled clock */
#define COLUMN_MASK 0xFFFFU
#define ROW_SHIFT 16U
#define ROW_MASK 0x7FFFU
#define POLARITY_BITS 1U /* that an entry of the look-up has not */
#define BIAS_MAX 255U /* added to the distance of a place */
#define SEVERAL 7U    /* gains */
#define CONTRAST_COUNT_MAX 1023U /* at which counters of contrast codes saturate */
#define LEVEL_MAX 2560U           /* its logarithm in units of 1/256 octave */
#define BEFORE 3U /* windows of which counts are kept, with seven gains */
#define LEVEL_FRACTION_BITS 8U
#define LEVEL_HALF 128U
#define MEAN_FRACTION_BITS 8U
#define MEAN_HALF 128U
#define FIRST_SHIFT 4U /* a running mean moves by 1/16 at first, by 1/256 in the end */
#define LAST_SHIFT 8U
#define EVENTS_TOP 0x7FFFFFU
#define ACTIVITY_FRACTION_BITS 8U
#define ACTIVITY_SHIFT 6U
#define PAUSE_DECAY_BITS 10U /* in a pause, the mean falls by 1/1024, rounded up */
#define PAUSE_DECAY_MOST 1023U
#define PAUSE_BITS 11U /* of a number of events less than 1/8 of the mean */
#define LEAST_ACTIVITY (-368) /* of no events, against the most */
#define OCTAVE 16U
#define OCTAVES_LOW 22U
#define OCTAVE_LOW 0x400000U /* 2^22 */

_Static_assert(sizeof(vpr_event_t) == 8U, "an event is two words");
_Static_assert(sizeof(vpr_entry_t) == 8U, "an entry of the image's look-up is two words");
#ifdef __BYTE_ORDER__
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the image is little-endian");
#endif

/* called once: small rather than fast; Clang would unroll each check */
#ifdef __GNUC__
#define ONCE __attribute__((cold))
#else
#define ONCE
#endif

/* The search over the places of one match, in ascending order. */
typedef struct {
    uint32_t left_sum; /* best of the places that have left the delay line */
    uint32_t left;
    uint32_t taken; /* places so far */
    uint32_t at;    /* in the delay line */
} search_t;

static uint32_t rounded_up(uint32_t bytes)
{
    return (bytes + 15U) & ~(uint32_t)15U;
}

/* Whether the words of the place filter and of contrast codes suit one another; those that the design
 * does not use are zero. */
static bool adaptive_within_limits(const uint32_t *image)
{
    const bool filters = image[AT_PLACES_PER_WINDOW] != 0U;
    const bool contrast = image[AT_CONTRAST] != 0U;
    const uint32_t of_filter = image[AT_RESTART] | image[AT_TRUST] | image[AT_GAINS];
    const uint32_t activity_max =
        (filters || contrast) ? (EVENTS_TOP << ACTIVITY_FRACTION_BITS) : 0U;
    const bool gains = (image[AT_GAINS] == 1U) || ((image[AT_GAINS] == SEVERAL) && contrast &&
                                                   (image[AT_WINDOW_KIND] == 0U));
    return (filters ? ((image[AT_LENGTH] == 1U) && gains) : (of_filter == 0U)) &&
           (image[AT_ACTIVITY] <= activity_max);
}

/* Whether every word of the header is within its range, each alone and those that are multiplied
 * together. */
static bool within_limits(const uint32_t *image)
{
    for (uint32_t i = 0U; i < (sizeof image_range / sizeof *image_range); i++) {
        const uint32_t value = image[image_range[i].word];
        if ((value < image_range[i].least) || (value > image_range[i].most)) {
            return false;
        }
    }
    const uint32_t slots = image[AT_PIXELS];
    const uint32_t depth = image[AT_LOOKUP_DEPTH];
    const uint32_t distance_max = (slots * ((1U << image[AT_CODE_BITS]) - 1U)) +
                                  ((image[AT_PLACES_PER_WINDOW] != 0U) ? BIAS_MAX : 0U);
    /* by time, windows are shorter than half the clock's period */
    const uint32_t windows = (image[AT_WINDOW_KIND] == 0U)
                                 ? (((uint32_t)1U << (image[AT_TIMESTAMP_BITS] - 1U)) - 1U)
                                 : VPR_NONE;
    return (image[AT_STRIDE] == rounded_up(slots)) && ((depth - 1U) <= LIMIT) &&
           ((depth & (depth - 1U)) == 0U) && ((image[AT_WINDOW] - 1U) < windows) &&
           (image[AT_LENGTH] <= image[AT_PLACES]) &&
           (distance_max <= LIMIT) &&
           ((image[AT_PLACES] * image[AT_LENGTH]) <= (VPR_NONE / 8U)) && adaptive_within_limits(image);
}

/* Whether the tables fill the image behind its header; `at` is where each begins, in bytes. */
static bool laid_out(const uint32_t *image, uint32_t at[TABLES])
{
    uint32_t bytes[TABLES];
    uint32_t end = HEADER_WORDS * 4U;
    table_bytes(image, bytes);
    for (uint32_t i = 0U; i < (uint32_t)TABLES; i++) {
        const uint32_t padded = rounded_up(bytes[i]);
        if (padded > (image[AT_BYTES] - end)) {
            return false;
        }
        at[i] = end;
        end += padded;
    }
    return end == image[AT_BYTES];
}

/* Whether the image is as it was made: its beginning, its end and its checksum. */
static bool undamaged(const uint32_t *image, uint32_t image_bytes)
{
    if ((image_bytes < (HEADER_WORDS * 4U)) || (image[AT_MAGIC] != IMAGE_MAGIC) ||
        (image[AT_BYTES] < (HEADER_WORDS * 4U)) || (image[AT_BYTES] > image_bytes)) {
        return false;
    }
    uint32_t crc = VPR_NONE;
    for (uint32_t i = (uint32_t)AT_CRC + 1U; i < (image[AT_BYTES] / 4U); i++) {
        crc = crc_after(crc, image[i], 4U);
    }
    return image[AT_CRC] == ~crc;
}

static bool at_most(const uint8_t *bytes, uint32_t count, uint32_t most)
{
    for (uint32_t i = 0U; i < count; i++) {
        if (bytes[i] > most) {
            return false;
        }
    }
    return true;
}

static bool words_at_most(const uint16_t *words, uint32_t count, uint32_t most)
{
    for (uint32_t i = 0U; i < count; i++) {
        if (words[i] > most) {
            return false;
        }
    }
    return true;
}

/* Whether the look-up has one entry for each selected pixel, where events of the pixel look for it,
 * with its slots. */
static bool lookup_sound(const vpr_design_t *d, uint32_t width, uint32_t pixels)
{
    uint32_t owned = 0U;
    for (uint32_t at = 0U; at <= d->lookup_mask; at++) {
        const vpr_entry_t *const entry = &d->lookup[at];
        const uint32_t pixel = entry->pixel >> POLARITY_BITS;
        const uint32_t column = pixel & COLUMN_MASK;
        const uint32_t y = pixel >> ROW_SHIFT;
        if (entry->pixel == VPR_NONE) {
            continue;
        }
        if ((entry->pixel != (pixel << POLARITY_BITS)) || (column >= width) || (y >= d->height) ||
            (((column + d->displacement[y]) & d->lookup_mask) != at) ||
            (entry->slot >= pixels)) {
            return false;
        }
        owned++;
    }
    return owned == pixels;
}

/* Whether the logarithms that contrast codes are made of are within their range. */
static bool levels_sound(const vpr_design_t *d)
{
    return !d->contrast || (words_at_most(d->level, d->count_max + 1U, LEVEL_MAX) &&
                            words_at_most(d->mean, d->slots, LEVEL_MAX) &&
                            words_at_most(d->limit, d->slots, CONTRAST_COUNT_MAX));
}

/* Whether no place has a code beyond the largest, and padding that is not zero. */
static bool places_sound(const vpr_design_t *d)
{
    const uint8_t *codes = d->places;
    for (uint32_t place = 0U; place < d->place_count; place++) {
        if (!at_most(codes, d->slots, d->code_max) ||
            !at_most(&codes[d->slots], d->stride - d->slots, 0U)) {
            return false;
        }
        codes = &codes[d->stride];
    }
    return true;
}

ONCE bool vpr_open(vpr_design_t *d, const uint32_t *image, uint32_t image_bytes)
{
    uint32_t at[TABLES];
    if (!undamaged(image, image_bytes) || !within_limits(image) || !laid_out(image, at)) {
        return false;
    }
    const uint8_t *const bytes = (const uint8_t *)image;
    const bool by_time = image[AT_WINDOW_KIND] == 0U;

    /* MISRA deviation 11.3: the tables lie aligned in the image */
    d->displacement = (const uint16_t *)(const void *)&bytes[at[TABLE_DISPLACEMENT]];
    d->lookup = (const vpr_entry_t *)(const void *)&bytes[at[TABLE_LOOKUP]];
    d->level = (const uint16_t *)(const void *)&bytes[at[TABLE_LEVEL]];
    d->place_activity = (const int8_t *)(const void *)&bytes[at[TABLE_PLACE_ACTIVITY]];
    d->place_bias = &bytes[at[TABLE_PLACE_BIAS]];
    d->mean = (const uint16_t *)(const void *)&bytes[at[TABLE_MEAN]];
    d->limit = (const uint16_t *)(const void *)&bytes[at[TABLE_LIMITS]];
    d->places = &bytes[at[TABLE_PLACES]];
    d->height = image[AT_HEIGHT];
    d->lookup_mask = image[AT_LOOKUP_DEPTH] - 1U;
    d->slots = image[AT_PIXELS];
    d->stride = image[AT_STRIDE];
    d->code_max = (1U << image[AT_CODE_BITS]) - 1U;
    d->contrast = image[AT_CONTRAST] != 0U;
    d->count_max = d->contrast ? CONTRAST_COUNT_MAX : d->code_max;
    d->time_scale = by_time ? ((uint32_t)1U << (32U - image[AT_TIMESTAMP_BITS])) : 0U;
    d->tau = image[AT_WINDOW] * d->time_scale;
    d->budget = by_time ? 0U : image[AT_WINDOW];
    d->place_count = image[AT_PLACES];
    d->length = image[AT_LENGTH];
    d->exclusion = image[AT_EXCLUSION];
    d->largest_sum = image[AT_LARGEST_SUM];
    d->steps = (image[AT_PLACES_PER_WINDOW] == 0U)
                   ? 0U
                   : ((image[AT_PLACES_PER_WINDOW] == 1U) ? STEPS : HALF_STEPS);
    d->gains = image[AT_GAINS];
    d->sums = (d->gains > 1U) ? SUMS : 1U;
    d->lane_shift = (d->gains > 1U) ? LANES_SHIFT : 0U;
    d->restart = image[AT_RESTART];
    d->trust = image[AT_TRUST];
    d->activity = image[AT_ACTIVITY];
    d->checksum = image[AT_CRC];
    return words_at_most(d->displacement, d->height, d->lookup_mask) &&
           lookup_sound(d, image[AT_WIDTH], image[AT_PIXELS]) && levels_sound(d) && places_sound(d);
}

/* Bytes of each array of the state, in the order in which they lie in the RAM. */
typedef struct {
    uint32_t query;
    uint32_t counts;
    uint32_t before;
    uint32_t kept;     /* metrics, or the history of sequences */
    uint32_t searched; /* distances, or the delay line of sequences */
    uint32_t mean;
} arrays_t;

static arrays_t arrays_of(const vpr_design_t *d)
{
    const bool filters = d->steps != 0U;
    arrays_t bytes;
    bytes.query = d->sums * d->stride;
    bytes.counts = rounded_up(d->slots * 2U);
    bytes.before = (d->gains > 1U) ? rounded_up(d->slots * 2U * BEFORE) : 0U;
    bytes.kept = rounded_up(filters ? (d->place_count << d->lane_shift)
                                    : (d->length * d->place_count * 2U));
    bytes.searched =
        rounded_up(filters ? (d->place_count * 2U) : ((d->exclusion + 1U) * 4U));
    bytes.mean = d->contrast ? rounded_up(d->sums * d->slots * 4U) : 0U;
    return bytes;
}

uint32_t vpr_ram_bytes(const vpr_design_t *d)
{
    const arrays_t bytes = arrays_of(d);
    return bytes.query + bytes.counts + bytes.before + bytes.kept + bytes.searched + bytes.mean;
}

/* Cut one block into the arrays of the state. */
static void place_arrays(const vpr_design_t *d, vpr_state_t *s, uint32_t *ram)
{
    /* MISRA deviation 11.3: the arrays are aligned */
    const arrays_t of = arrays_of(d);
    uint8_t *at = (uint8_t *)ram;
    s->query = at;
    at = &at[of.query];
    s->counts = (uint16_t *)(void *)at;
    at = &at[of.counts];
    s->before = (uint16_t *)(void *)at;
    at = &at[of.before];
    s->history = (uint16_t *)(void *)at;
    s->metric = at;
    s->bank = (uint32_t *)(void *)at;
    at = &at[of.kept];
    s->delay = (uint32_t *)(void *)at;
    s->distance = (uint16_t *)(void *)at;
    at = &at[of.searched];
    s->mean = (uint32_t *)(void *)at;
}

ONCE void vpr_reset(const vpr_design_t *d, vpr_state_t *s, uint32_t *ram, uint32_t start)
{
    place_arrays(d, s, ram);
    s->checksum = d->checksum;

    /* the padding of the query must be zero as that of the places is, and in the first window a
     * metric must be what the restart leads to; the rest is written before it is read */
    for (uint32_t i = 0U; i < (d->sums * d->stride); i++) {
        s->query[i] = 0U;
    }
    for (uint32_t i = 0U; i < d->slots; i++) {
        s->counts[i] = 0U;
    }
    for (uint32_t i = 0U; (d->gains > 1U) && (i < (d->slots * BEFORE)); i++) {
        s->before[i] = 0U;
    }
    for (uint32_t i = 0U; (d->steps != 0U) && (i < (d->place_count << d->lane_shift)); i++) {
        s->metric[i] = 0U;
    }
    /* by count, all times are scaled to 0 */
    s->window_end = (d->tau != 0U) ? ((start * d->time_scale) + d->tau) : 1U;
    s->left = d->budget;
    s->windows = 0U;
    s->seen = 0U;
    s->newest = 0U;
    s->mean_activity = d->activity;
    s->activity = 0;
    s->paused = false;
    s->mean_shift = FIRST_SHIFT;
    s->mean_windows = 1U << FIRST_SHIFT;
    for (uint32_t i = 0U; i < SUMS; i++) {
        s->reciprocal[i] = 0U;
    }
    s->least = 0U;
    s->place = VPR_NONE;
    s->gain = 0U;
    s->few = 0U;
    s->speed = (uint32_t)LOG_TOP << SPEED_BITS;
    s->moved = 0U;
    s->support = 0U;
    s->age = 0U;
    s->residual = 0U;
    s->residual_before = 0U;
    for (uint32_t sum = 0U; d->contrast && (sum < d->sums); sum++) {
        for (uint32_t i = 0U; i < d->slots; i++) {
            s->mean[(sum * d->slots) + i] = (uint32_t)d->mean[i] << MEAN_FRACTION_BITS;
        }
    }
}

bool vpr_resume(const vpr_design_t *d, vpr_state_t *s, uint32_t *ram)
{
    if (s->checksum != d->checksum) {
        return false;
    }
    place_arrays(d, s, ram);
    return true;
}

/* A row's pixels lie in the look-up from its displacement on, between those of other rows: an entry
 * names its owner. It also tells pixels beyond the sensor's width from those within. */
uint32_t vpr_slot(const vpr_design_t *d, const vpr_event_t *e)
{
    const uint32_t y = (e->pixel >> ROW_SHIFT) & ROW_MASK;
    if (y >= d->height) {
        return VPR_NONE;
    }
    const uint32_t column = e->pixel & COLUMN_MASK;
    const vpr_entry_t *const entry = &d->lookup[(column + d->displacement[y]) & d->lookup_mask];
    if (entry->pixel != (e->pixel << POLARITY_BITS)) {
        return VPR_NONE;
    }
    return entry->slot;
}

/* The same look-up as in vpr_slot stands in the loop: what does not change stays in registers. */
vpr_status_t vpr_events(const vpr_design_t *d, vpr_state_t *s, const vpr_event_t **next,
                        const vpr_event_t *end)
{
    const uint16_t *const displacement = d->displacement;
    const vpr_entry_t *const lookup = d->lookup;
    const uint32_t height = d->height;
    const uint32_t lookup_mask = d->lookup_mask;
    const uint32_t count_max = d->count_max;
    const uint32_t time_scale = d->time_scale;
    const uint32_t window_end = s->window_end;
    uint16_t *const counts = s->counts;
    uint32_t left = s->left;
    vpr_status_t status = VPR_ALL_TAKEN;
    const vpr_event_t *e = *next;

    while (e != end) {
        /* What is left of the window, modulo 2^timestamp_bits, read as a signed number: the clock
         * may wrap, and an event that is late counts in the open window. */
        const bool ended = (int32_t)(window_end - (e->t * time_scale)) <= 0;
        const uint32_t pixel = e->pixel;
        const uint32_t y = (pixel >> ROW_SHIFT) & ROW_MASK;
        /* compares the pixel first, whether or not the window has ended: the compiler then loads
         * both words of an event together */
        if ((y >= height) && !ended) {
            e = &e[1];
            continue;
        }
        if (ended) {
            status = VPR_WINDOW_ENDS;
            break;
        }
        e = &e[1];
        const uint32_t at = ((pixel & COLUMN_MASK) + displacement[y]) & lookup_mask;
        if (lookup[at].pixel != (pixel << POLARITY_BITS)) {
            continue;
        }
        const uint32_t slot = lookup[at].slot;
        const uint32_t count = counts[slot];
        counts[slot] = (uint16_t)((count < count_max) ? (count + 1U) : count);
        left--;
        if (left == 0U) {
            status = VPR_WINDOW_ENDS;
            break;
        }
    }
    s->left = left;
    *next = e;
    return status;
}

uint32_t vpr_time(const vpr_design_t *d, const vpr_state_t *s, uint32_t t)
{
    /* by count, the window ends at 1 and no time is later than 0 */
    const uint32_t late = (t * d->time_scale) - s->window_end;
    return (late <= HALF_PERIOD) ? (quotient(late, d->tau) + 1U) : 0U;
}

static uint32_t rounded(uint32_t mean)
{
    return (mean + MEAN_HALF) >> MEAN_FRACTION_BITS;
}

/* Mean over the window of the logarithms less their counters' means, rounded. No logarithm is below its
 * mean by more than LEVEL_MAX, which is added. */
static uint32_t window_mean(const vpr_design_t *d, const vpr_state_t *s, const uint32_t *means)
{
    const uint16_t *const levels = d->level;
    const uint16_t *const counts = s->counts;
    uint32_t total = 0U;
    for (uint32_t i = 0U; i < d->slots; i++) {
        total += (levels[lesser(counts[i], CONTRAST_COUNT_MAX)] + LEVEL_MAX) - rounded(means[i]);
    }
    return quotient((total * 2U) + d->slots, d->slots * 2U);
}

/* Code each count of a sum, which is in `counts`, against the running mean of its counter and the mean
 * of the window; move the running means unless the window is a pause. */
static void code_sum(const vpr_design_t *d, const vpr_state_t *s, uint32_t sum)
{
    const uint32_t code_max = d->code_max;
    /* codes have no sign: half of their range is added */
    const uint32_t half = (((code_max + 1U) / 2U) << LEVEL_FRACTION_BITS) + LEVEL_HALF + LEVEL_MAX;
    const uint16_t *const levels = d->level;
    const uint16_t *const counts = s->counts;
    const uint32_t shift = s->mean_shift;
    uint32_t *const means = &s->mean[sum * d->slots];
    uint8_t *const query = &s->query[sum * d->stride];
    const uint32_t of_window = window_mean(d, s, means);
    for (uint32_t i = 0U; i < d->slots; i++) {
        const uint32_t level = levels[lesser(counts[i], CONTRAST_COUNT_MAX)];
        const uint32_t mean = rounded(means[i]) + of_window;
        const uint32_t above = level + half;
        const uint32_t octaves = ((above > mean) ? (above - mean) : 0U) >> LEVEL_FRACTION_BITS;
        query[i] = (uint8_t)lesser(octaves, code_max);
        if (!s->paused) {
            means[i] = moved(means[i], level << MEAN_FRACTION_BITS, shift);
        }
    }
}

/* Code the sums of the newest four and two windows, with seven gains, and keep the counts. */
static void code_sums(const vpr_design_t *d, vpr_state_t *s)
{
    uint16_t *const counts = s->counts;
    uint16_t *const one = s->before;
    uint16_t *const two = &one[d->slots];
    uint16_t *const three = &two[d->slots];
    for (uint32_t i = 0U; i < d->slots; i++) {
        counts[i] = (uint16_t)(counts[i] + one[i] + two[i] + three[i]);
    }
    code_sum(d, s, 2U);
    for (uint32_t i = 0U; i < d->slots; i++) {
        counts[i] = (uint16_t)(counts[i] - two[i] - three[i]);
    }
    code_sum(d, s, 1U);
    for (uint32_t i = 0U; i < d->slots; i++) {
        counts[i] = (uint16_t)(counts[i] - one[i]);
        three[i] = two[i];
        two[i] = one[i];
        one[i] = counts[i];
    }
}

static void contrast_codes(const vpr_design_t *d, vpr_state_t *s)
{
    if (d->gains > 1U) {
        code_sums(d, s);
    }
    code_sum(d, s, 0U);
    if (!s->paused && (s->mean_shift < LAST_SHIFT)) {
        s->mean_windows++;
        if (s->mean_windows == (2U << s->mean_shift)) {
            s->mean_shift++;
        }
    }
}

/* 16 times the logarithm of 1 and a number of events, to the base 2, rounded down. */
static uint32_t event_log(uint32_t events)
{
    /* the least numbers that are 1/16, 2/16 ... 16/16 octave above OCTAVE_LOW, and beyond all */
    static const uint32_t sixteenth[OCTAVE + 1U] = {
        4380002U, 4573921U, 4776426U, 4987897U, 5208730U, 5439340U, 5680160U, 5931642U, 6194258U,
        6468502U, 6754887U, 7053951U, 7366256U, 7692388U, 8032959U, 8388608U, VPR_NONE};
    uint32_t number = events + 1U;
    uint32_t sixteenths = OCTAVE * OCTAVES_LOW;
    uint32_t above = 0U;
    while (number < OCTAVE_LOW) {
        number <<= 1;
        sixteenths -= OCTAVE;
    }
    while (number >= sixteenth[above]) {
        above++;
    }
    return sixteenths + above;
}

/* The events of the open window that count: of contrast codes, no pixel gives more than its limit. */
static uint32_t counted_events(const vpr_design_t *d, const vpr_state_t *s)
{
    uint32_t counted = d->contrast ? 0U : (d->budget - s->left);
    for (uint32_t i = 0U; d->contrast && (i < d->slots); i++) {
        counted += lesser(s->counts[i], d->limit[i]);
    }
    return lesser(counted, EVENTS_TOP);
}

/* Compute the activity of the open window, whether it is a pause, and the mean number of events with
 * it. A pause has at most `below` / 2048, rounded down: less than 1/8 of the mean number. */
static void take_activity(const vpr_design_t *d, vpr_state_t *s)
{
    const uint32_t events = counted_events(d, s);
    const uint32_t mean = (d->gains > 1U) ? d->activity : s->mean_activity;
    const uint32_t below = (s->mean_activity > 0U) ? (s->mean_activity - 1U) : 0U; /* without events: it does */
    s->activity = (events == 0U) ? LEAST_ACTIVITY
                                 : ((int32_t)event_log(events) -
                                    (int32_t)event_log(mean >> ACTIVITY_FRACTION_BITS));
    s->paused = events <= (below >> PAUSE_BITS);
    if (s->paused) {
        s->mean_activity -= (s->mean_activity + PAUSE_DECAY_MOST) >> PAUSE_DECAY_BITS;
    } else {
        s->mean_activity = moved(s->mean_activity, events << ACTIVITY_FRACTION_BITS, ACTIVITY_SHIFT);
    }
}

void vpr_window_end(const vpr_design_t *d, vpr_state_t *s)
{
    take_activity(d, s);
    if (d->contrast) {
        contrast_codes(d, s);
    }
    for (uint32_t i = 0U; i < d->slots; i++) {
        if (!d->contrast) {
            s->query[i] = (uint8_t)s->counts[i];
        }
        s->counts[i] = 0U;
    }
    s->window_end += d->tau;
    s->left = d->budget; /* by time: 0, which becomes 0 again after 2^32 events only */
    s->windows++;
    if (s->seen < d->length) {
        s->seen++;
    }
}

/* Add the distances of the windows before the newest one, along the diagonal. */
static uint32_t sequence_sum(const vpr_design_t *d, const vpr_state_t *s, uint32_t place)
{
    uint32_t row = s->newest;
    uint32_t at = (row * d->place_count) + place;
    uint32_t sum = s->history[at];
    for (uint32_t i = 1U; i < d->length; i++) {
        if (row == 0U) {
            row = d->length;
            at += d->length * d->place_count;
        }
        row--;
        at -= d->place_count + 1U;
        sum += s->history[at];
    }
    return sum;
}

/* Take one place's sum into the search: running minimum, ties to the lowest place. What lies left
 * of the zone around a new best is known already; what lies right of it comes later. */
static void search(const vpr_design_t *d, uint32_t *delay, search_t *f, vpr_match_t *m,
                   uint32_t place, uint32_t sum)
{
    if (f->taken > d->exclusion) {
        const uint32_t left_sum = delay[f->at];
        if ((f->left == VPR_NONE) || (left_sum < f->left_sum)) {
            f->left = place - d->exclusion - 1U;
            f->left_sum = left_sum;
        }
    }
    delay[f->at] = sum;
    f->at = (f->at == d->exclusion) ? 0U : (f->at + 1U);

    if ((f->taken == 0U) || (sum < m->sum)) {
        m->place = place;
        m->sum = sum;
        m->ties = 0U;
        m->second = f->left;
        m->second_sum = f->left_sum;
    } else {
        if (sum == m->sum) {
            m->ties++;
        }
        if (((place - m->place) > d->exclusion) &&
            ((m->second == VPR_NONE) || (sum < m->second_sum))) {
            m->second = place;
            m->second_sum = sum;
        }
    }
    f->taken++;
}

static bool accepted(const vpr_design_t *d, const vpr_match_t *m)
{
    if (d->steps != 0U) {
        return (m->second != VPR_NONE) && (m->trust >= d->trust);
    }
    return m->sum <= d->largest_sum;
}

static bool match_sequences(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m)
{
    search_t best = {VPR_NONE, VPR_NONE, 0U, 0U};
    const uint8_t *codes = d->places;
    const bool complete = s->seen == d->length;

    s->newest = ((s->newest + 1U) == d->length) ? 0U : (s->newest + 1U);
    for (uint32_t place = 0U; place < d->place_count; place++) {
        const uint32_t distance = sad(s->query, codes, d->stride);
        s->history[(s->newest * d->place_count) + place] = (uint16_t)distance;
        if (complete && ((place + 1U) >= d->length)) {
            search(d, s->delay, &best, m, place, sequence_sum(d, s, place));
        }
        codes = &codes[d->stride];
    }
    m->trust = 0U;
    return complete;
}

bool vpr_match_places(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m)
{
    bool matched = true;
    if (d->steps != 0U) {
        filter_places(d, s, m);
    } else {
        matched = match_sequences(d, s, m);
    }
    if (matched) {
        m->window = s->windows - 1U;
        m->accepted = accepted(d, m);
    }
    return matched;
}
