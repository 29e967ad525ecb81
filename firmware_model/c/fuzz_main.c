/* `fuzz IMAGES SEED FIRST NUMBER`: damage images, open them, and run what opens on random events.
 * IMAGES is their number, and each one's bytes and contents, in 32-bit words. Image i of a seed is
 * the same whatever FIRST and NUMBER are. Prints the numbers of images, of those that
 * opened, of those that ran, and of their events, windows and matches. Not part of the firmware. */
#define _POSIX_C_SOURCE 200809L

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "crc.h"
#include "tables.h"
#include "vpr.h"

#define WORDS (1U << 20)
#define BASES_MAX 256U
#define RAM_MAX (1U << 20)   /* larger ones open, and do not run */
#define WORK_MAX 2000000.0   /* terms of sums in one match: those above do not run */
#define EVENTS 240U
#define WINDOWS 48U /* at most, in one run */
#define SECONDS 20U          /* without an end: an endless loop */

static uint32_t bundle[WORDS];
static const uint32_t *base[BASES_MAX]; /* its bytes, and behind them the image */
static uint32_t bases;
static uint64_t state;
static volatile unsigned long current;

static struct {
    unsigned long images;
    unsigned long opened;
    unsigned long ran;
    unsigned long events;
    unsigned long windows;
    unsigned long matches;
} done;

static uint32_t random_word(void) /* splitmix64 */
{
    state += 0x9E3779B97F4A7C15U;
    uint64_t z = state;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
    return (uint32_t)((z ^ (z >> 31)) >> 32);
}

static uint32_t below(uint32_t limit)
{
    return (limit == 0U) ? 0U : (random_word() % limit);
}

/* Of the signals that end a run: says which image it was. */
static void report(int number)
{
    char text[64];
    const int size = snprintf(text, sizeof text, "fuzz: signal %d at image %lu\n", number, current);
    if (write(STDERR_FILENO, text, (size_t)size) < 0) {
        _exit(4);
    }
    _exit(3);
}

static void is_out_of_range(const char *what)
{
    (void)fprintf(stderr, "fuzz: %s is out of its range at image %lu\n", what, current);
    exit(3);
}

/* Damage an image in one place; the number of its bytes from then on. */
static uint32_t damage(uint8_t *image, uint32_t bytes)
{
    const uint32_t at = below(bytes);
    switch (below(8U)) {
    case 0U: /* cut off */
        return at;
    case 1U: /* a small byte, as in most words of the header and most entries of tables */
        image[at] = (uint8_t)below(8U);
        break;
    case 2U:
        image[at] = (uint8_t)random_word();
        break;
    default:
        image[at] ^= (uint8_t)(1U << below(8U));
        break;
    }
    return bytes;
}

/* Write the size and the checksum of what the image has become, so that the rest is looked at. */
static void seal(uint8_t *image, uint32_t bytes)
{
    if (bytes < (HEADER_WORDS * 4U)) {
        return;
    }
    const uint32_t from = (AT_CRC + 1U) * 4U;
    uint32_t crc = ~(uint32_t)0;
    for (uint32_t i = from; i < bytes; i++) {
        crc = crc_after(crc, image[i], 1U);
    }
    crc = ~crc;
    memcpy(&image[AT_BYTES * 4U], &bytes, 4U);
    memcpy(&image[AT_CRC * 4U], &crc, 4U);
}

/* An event near the open window's end, or anywhere in time; at a selected pixel, or elsewhere. */
static vpr_event_t random_event(const vpr_design_t *d, const vpr_state_t *s)
{
    const uint32_t scale = (d->time_scale == 0U) ? 1U : d->time_scale;
    const uint32_t pixel = d->lookup[below(d->lookup_mask + 1U)].pixel;
    vpr_event_t e = {((s->window_end - below(d->tau)) / scale) + below(2U), random_word()};
    if (below(24U) == 0U) {
        e.t = random_word();
    }
    if ((pixel != VPR_NONE) && (below(8U) != 0U)) {
        e.pixel = (below(2U) << 31) | (pixel >> 1);
    }
    return e;
}

/* End the window and match it: what is returned lies in the ranges of the image. */
static void end_window(const vpr_design_t *d, vpr_state_t *s)
{
    vpr_match_t got;
    vpr_window_end(d, s);
    for (uint32_t i = 0U; i < d->slots; i++) {
        if (s->query[i] > d->code_max) {
            is_out_of_range("a code");
        }
    }
    memset(&got, 0xA5, sizeof got);
    const bool matched = vpr_match_places(d, s, &got);
    done.windows++;
    if (!matched) {
        return;
    }
    done.matches++;
    if ((got.place >= d->place_count) || (got.ties >= d->place_count)) {
        is_out_of_range("a match");
    }
    if (got.second != VPR_NONE) {
        /* the filter tells the middle of the places near the best */
        const uint32_t best = (d->steps != 0U) ? s->place : got.place;
        const bool left = got.second < best;
        const uint32_t apart = left ? (best - got.second) : (got.second - best);
        if ((got.second >= d->place_count) || (apart <= d->exclusion) ||
            (got.second_sum < got.sum)) {
            is_out_of_range("a second best");
        }
    }
}

/* Events one after another, or a few that lie in one window. */
static void run(const vpr_design_t *d)
{
    const uint32_t ram_bytes = vpr_ram_bytes(d);
    vpr_state_t s;
    const double terms = (double)d->place_count * d->length * d->slots;
    if ((ram_bytes > RAM_MAX) || ((d->length <= WINDOWS) && (terms > WORK_MAX))) {
        return;
    }
    uint32_t *const ram = malloc(ram_bytes);
    if (ram == NULL) {
        abort();
    }
    memset(ram, (int)below(256U), ram_bytes);
    memset(&s, 0xA5, sizeof s);
    vpr_reset(d, &s, ram, random_word());
    uint32_t taken = 0U;
    while ((taken < EVENTS) && (s.windows < WINDOWS)) {
        vpr_event_t batch[4];
        const uint32_t size = 1U + below(4U);
        for (uint32_t i = 0U; i < size; i++) {
            batch[i] = random_event(d, &s);
        }
        const vpr_event_t *next = batch;
        const vpr_event_t *const end = &batch[size];
        while ((next != end) && (s.windows < WINDOWS)) {
            const vpr_event_t *const from = next;
            const vpr_status_t status = vpr_events(d, &s, &next, end);
            taken += (uint32_t)(next - from);
            done.events += (unsigned long)(next - from);
            for (uint32_t i = 0U; i < d->slots; i++) {
                if (s.counts[i] > d->count_max) {
                    is_out_of_range("a count");
                }
            }
            if (status == VPR_WINDOW_ENDS) {
                end_window(d, &s);
            }
        }
    }
    free(ram);
    done.ran++;
}

static void one(void)
{
    const uint32_t *const from = base[below(bases)];
    uint32_t bytes = from[0];
    uint32_t *const room = malloc(bytes);
    if (room == NULL) {
        abort();
    }
    memcpy(room, &from[1], bytes);
    do {
        bytes = damage((uint8_t *)room, bytes);
    } while ((below(3U) == 0U) && (bytes > HEADER_WORDS));
    /* as long as it is and no longer, so that reads behind it are found */
    uint32_t *const image = malloc((bytes == 0U) ? 1U : bytes);
    if (image == NULL) {
        abort();
    }
    memcpy(image, room, bytes);
    free(room);
    if (below(16U) != 0U) {
        seal((uint8_t *)image, bytes);
    }
    vpr_design_t design;
    memset(&design, 0xA5, sizeof design);
    done.images++;
    if (vpr_open(&design, image, bytes)) {
        done.opened++;
        run(&design);
    }
    free(image);
}

static bool read_bases(const char *path)
{
    FILE *const file = fopen(path, "rb");
    if (file == NULL) {
        return false;
    }
    const size_t words = fread(bundle, sizeof *bundle, WORDS, file);
    (void)fclose(file);
    size_t at = 1U;
    bases = bundle[0];
    for (uint32_t i = 0U; (i < bases) && (bases <= BASES_MAX); i++) {
        base[i] = &bundle[at];
        at += 1U + ((bundle[at] + 3U) / 4U);
        if (at > words) {
            return false;
        }
    }
    return (bases > 0U) && (bases <= BASES_MAX);
}

int main(int argc, char **argv)
{
    if ((argc != 5) || !read_bases(argv[1])) {
        (void)fprintf(stderr, "usage: fuzz IMAGES SEED FIRST NUMBER\n");
        return 2;
    }
    const uint64_t seed = strtoull(argv[2], NULL, 10);
    const unsigned long first = strtoul(argv[3], NULL, 10);
    const unsigned long number = strtoul(argv[4], NULL, 10);
    (void)signal(SIGABRT, report);
    (void)signal(SIGALRM, report);
    for (unsigned long i = 0U; i < number; i++) {
        current = first + i;
        state = (seed << 40) + (current << 8);
        (void)alarm(SECONDS);
        one();
    }
    (void)alarm(0U);
    (void)printf("%lu %lu %lu %lu %lu %lu\n", done.images, done.opened, done.ran, done.events,
                 done.windows, done.matches);
    return 0;
}
