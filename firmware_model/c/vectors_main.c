/* `vectors BUNDLE`: images that must open or must not, and cases with their expected records, all in
 * one file (firmware_model/vectors/bundle.py). Stops at the first difference. Not part of the
 * firmware. */
#include <stdio.h>
#include <string.h>

#include "replay.h"

#define WORDS (1U << 23)
#define BEYOND 64U /* bytes behind the RAM that must stay as they are */

static uint32_t bundle[WORDS];
static _Alignas(16) uint32_t image[WORDS];
static _Alignas(16) uint32_t ram[WORDS];
static uint32_t expected[WORDS];
static uint32_t out[WORDS];
static size_t at;

static uint32_t next_word(void)
{
    const uint32_t word = bundle[at];
    at++;
    return word;
}

/* Copy what comes next, its bytes filled up to words; behind it lies what no image has. */
static uint32_t next_block(uint32_t *to)
{
    const uint32_t bytes = next_word();
    const size_t words = ((size_t)bytes + 3U) / 4U;
    memcpy(to, &bundle[at], words * 4U);
    memset(&to[words], 0x5A, 256U);
    at += words;
    return bytes;
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
        const uint32_t bytes = next_block(image);
        if (vpr_open(&design, image, bytes) != opens) {
            return differs(opens ? "refused: image" : "opened: image", i);
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

static bool same(const vpr_event_t *events, uint32_t count, uint32_t batch, uint32_t start,
                 uint32_t image_bytes, uint32_t ram_bytes, uint32_t words)
{
    uint8_t *const behind = (uint8_t *)ram + ram_bytes;
    memset(behind, 0x3C, BEYOND);
    const uint32_t written = vpr_replay(image, image_bytes, events, count, batch, start, ram,
                                        ram_bytes, out, (uint32_t)WORDS);
    for (uint32_t i = 0U; i < BEYOND; i++) {
        if (behind[i] != 0x3CU) {
            return false;
        }
    }
    return (written == words) && (memcmp(out, expected, (size_t)words * 4U) == 0);
}

static int check_cases(void)
{
    const uint32_t cases = next_word();
    for (uint32_t i = 0U; i < cases; i++) {
        const uint32_t start = next_word();
        const uint32_t ram_bytes = next_word();
        const uint32_t image_bytes = next_block(image);
        const uint32_t event_words = next_word() / 4U;
        const vpr_event_t *const events = (const vpr_event_t *)(const void *)&bundle[at];
        at += event_words;
        const uint32_t count = event_words / 2U;
        uint32_t words = next_block(expected) / 4U;
        if (!same(events, count, 1U, start, image_bytes, ram_bytes, words)) {
            return differs("case", i);
        }
        if (vpr_replay(image, image_bytes, events, count, 1U, start, ram, ram_bytes - 16U, out,
                       (uint32_t)WORDS) != 0U) {
            return differs("too little RAM taken: case", i);
        }
        words = without_events(words);
        if (!same(events, count, 7U, start, image_bytes, ram_bytes, words) ||
            !same(events, count, 1U << 20, start, image_bytes, ram_bytes, words)) {
            return differs("in batches: case", i);
        }
    }
    return 0;
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
    if ((words == 0U) || (words == WORDS)) {
        (void)fprintf(stderr, "vectors: the bundle is empty, or too large\n");
        return 2;
    }
    return ((check_images() != 0) || (check_cases() != 0)) ? 1 : 0;
}
