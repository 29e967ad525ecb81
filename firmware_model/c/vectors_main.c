/* `vectors BUNDLE`: images that must open or must not, and cases with their expected records, all in
 * one file (firmware_model/verification/images.py). Stops at the first difference. Not part of the
 * firmware. */
#define _DEFAULT_SOURCE

#include <stdio.h>
#include <string.h>
#include <sys/mman.h>

#include "quotient.h"
#include "replay.h"

#define WORDS (1U << 25)
#define PAGE 0x10000U /* or a part of one */
#define REPEATS 0x900000U /* of an event in one window, at most */
#define FURTHER 0xA000U  /* events behind them, at most */
#define CHECKSUM 3U /* word of an image */

static uint32_t bundle[WORDS];
static uint8_t *image_end; /* both end where no memory follows: to go on there is a fault */
static uint8_t *ram_end;
static uint32_t expected[WORDS];
static uint32_t out[WORDS];
static size_t at;

static uint32_t next_word(void)
{
    const uint32_t word = bundle[at];
    at++;
    return word;
}

/* The end of memory that is followed by none. */
static uint8_t *guarded(void)
{
    const size_t bytes = (size_t)WORDS * 4U;
    uint8_t *const memory =
        mmap(NULL, bytes + PAGE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if ((memory == MAP_FAILED) || (mprotect(&memory[bytes], PAGE, PROT_NONE) != 0)) {
        return NULL;
    }
    return &memory[bytes];
}

/* So many bytes at the end of guarded memory, aligned. */
static uint32_t *at_end(uint8_t *end, uint32_t bytes)
{
    return (uint32_t *)(void *)(end - ((bytes + 15U) & ~15U));
}

static const uint32_t *next_image(uint32_t *bytes)
{
    *bytes = next_word();
    uint32_t *const image = at_end(image_end, *bytes);
    memcpy(image, &bundle[at], *bytes);
    at += ((size_t)*bytes + 3U) / 4U;
    return image;
}

static int differs(const char *what, uint32_t number)
{
    (void)printf("%s %u\n", what, (unsigned)number);
    return 1;
}

static int check_images(void)
{
    const uint32_t images = next_word();
    for (uint32_t i = 0U; i < images; i++) {
        vpr_design_t design;
        const bool opens = next_word() != 0U;
        uint32_t bytes;
        const uint32_t *const image = next_image(&bytes);
        if (vpr_open(&design, image, bytes) != opens) {
            return differs(opens ? "refused: image" : "opened: image", i);
        }
        if (opens && (design.checksum != image[CHECKSUM])) {
            return differs("checksum of another image: image", i);
        }
    }
    return 0;
}

/* The records without those of events, which a batch has not. */
static uint32_t without_events(uint32_t words)
{
    uint32_t kept = 0U;
    uint32_t from = 0U;
    while (from < words) {
        const uint32_t size = 2U + expected[from + 1U];
        if (expected[from] != VPR_RECORD_EVENT) {
            memmove(&expected[kept], &expected[from], size * 4U);
            kept += size;
        }
        from += size;
    }
    return kept;
}

typedef struct {
    const uint32_t *image;
    uint32_t image_bytes;
    const vpr_event_t *events;
    uint32_t event_count;
    uint32_t start;
    uint32_t ram_bytes;
} case_t;

static uint32_t replay(const case_t *c, uint32_t batch, uint32_t ram_bytes)
{
    return vpr_replay(c->image, c->image_bytes, c->events, c->event_count, batch, c->start,
                      at_end(ram_end, ram_bytes), ram_bytes, out, (uint32_t)WORDS);
}

static bool same(const case_t *c, uint32_t batch, uint32_t ram_bytes, uint32_t words)
{
    return (replay(c, batch, ram_bytes) == words) &&
           (memcmp(out, expected, (size_t)words * 4U) == 0);
}

/* Windows of more events than any file has: the first event, so many times. */
static int check_long_windows(void)
{
    static vpr_event_t events[REPEATS + FURTHER];
    const uint32_t windows = next_word();
    for (uint32_t i = 0U; i < windows; i++) {
        case_t c;
        const uint32_t repeats = next_word();
        c.start = next_word();
        c.ram_bytes = next_word();
        c.image = next_image(&c.image_bytes);
        const uint32_t more = next_word() / 8U;
        if ((repeats > REPEATS) || (more > FURTHER)) {
            return differs("too long: window", i);
        }
        for (uint32_t j = 0U; j < repeats; j++) {
            memcpy(&events[j], &bundle[at], sizeof *events);
        }
        memcpy(&events[repeats], &bundle[at], more * sizeof *events);
        at += (size_t)more * 2U;
        c.events = events;
        c.event_count = repeats + more;
        const uint32_t words = next_word() / 4U;
        memcpy(expected, &bundle[at], (size_t)words * 4U);
        at += words;
        if (!same(&c, REPEATS + FURTHER, c.ram_bytes, words)) {
            return differs("long window", i);
        }
    }
    return 0;
}

static int check_cases(void)
{
    const uint32_t cases = next_word();
    for (uint32_t i = 0U; i < cases; i++) {
        case_t c;
        c.start = next_word();
        c.ram_bytes = next_word();
        c.image = next_image(&c.image_bytes);
        c.event_count = next_word() / 8U;
        c.events = (const vpr_event_t *)(const void *)&bundle[at];
        at += (size_t)c.event_count * 2U;
        uint32_t words = next_word() / 4U;
        memcpy(expected, &bundle[at], (size_t)words * 4U);
        at += words;
        if (!same(&c, 1U, c.ram_bytes, words)) {
            return differs("case", i);
        }
        if (!same(&c, 1U, 2U * c.ram_bytes, words)) {
            return differs("slept: case", i);
        }
        if (replay(&c, 1U, c.ram_bytes - 16U) != 0U) {
            return differs("too little RAM taken: case", i);
        }
        words = without_events(words);
        if (!same(&c, 7U, c.ram_bytes, words) || !same(&c, 1U << 20, c.ram_bytes, words)) {
            return differs("in batches: case", i);
        }
    }
    return 0;
}

/* Sums of distances reach 32 bits only of maps too large for a case. */
static int check_quotients(void)
{
    static const uint32_t numbers[] = {1U,          2U,          3U,          0x10000U,
                                       0x7FFFFFFFU, 0x80000000U, 0x80000001U, 0xFFFFFFFFU};
    const uint32_t count = (uint32_t)(sizeof numbers / sizeof *numbers);
    for (uint32_t i = 0U; i < (count * count); i++) {
        const uint32_t dividend = numbers[i / count];
        const uint32_t divisor = numbers[i % count];
        if (quotient(dividend, divisor) != (dividend / divisor)) {
            return differs("quotient", i);
        }
    }
    return (quotient(0U, 1U) != 0U) ? differs("quotient of zero", 0U) : 0;
}

int main(int argc, char **argv)
{
    FILE *const file = (argc == 2) ? fopen(argv[1], "rb") : NULL;
    if (file == NULL) {
        (void)fprintf(stderr, "usage: vectors BUNDLE\n");
        return 2;
    }
    const size_t words = fread(bundle, sizeof *bundle, WORDS, file);
    (void)fclose(file);
    image_end = guarded();
    ram_end = guarded();
    if ((image_end == NULL) || (ram_end == NULL) || (words == 0U) || (words == WORDS)) {
        (void)fprintf(stderr, "vectors: the bundle is empty or too large, or memory is short\n");
        return 2;
    }
    return ((check_quotients() != 0) || (check_images() != 0) || (check_cases() != 0) ||
            (check_long_windows() != 0))
               ? 1
               : 0;
}
