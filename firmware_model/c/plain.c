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
    MAP = 24
};

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
    p->end = (start + (uint64_t)plain_word(p, WINDOW)) % period(p);
    p->counted = 0U;
    p->windows = 0U;
}

void plain_free(plain_t *p)
{
    free(p->counts);
    free(p->codes);
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

const uint8_t *plain_window_end(plain_t *p)
{
    const uint32_t slots = plain_word(p, SLOTS);
    uint8_t *const codes = &p->codes[(size_t)p->windows * slots];
    const uint64_t entries = (uint64_t)plain_word(p, COUNT_MAX) + 1U;
    for (uint32_t slot = 0U; slot < slots; slot++) {
        const uint64_t table = byte_at(p, (uint64_t)plain_word(p, WHICH_CODES) + slot);
        codes[slot] =
            (uint8_t)byte_at(p, plain_word(p, CODES) + table * entries + p->counts[slot]);
        p->counts[slot] = 0U;
    }
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

bool plain_match(const plain_t *p, vpr_match_t *m)
{
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
        sums[k] = sequence(p, k);
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
    return true;
}
