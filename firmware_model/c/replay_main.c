/* `replay image.bin events.bin start.mem RESULTS`: run a case on this computer. */
#include <stdio.h>
#include <string.h>

#include "replay.h"

#define GUARD 4096U /* bytes behind the RAM, which nobody may write */
#define CANARY 0xC5

static _Alignas(16) uint32_t image[1U << 22];
static uint32_t events[1U << 22];
static _Alignas(16) uint32_t ram[1U << 22];
static uint32_t out[1U << 24];

static uint32_t read_words(const char *path, uint32_t *words, size_t size)
{
    FILE *const file = fopen(path, "rb");
    size_t used = 0U;
    if (file != NULL) {
        used = fread(words, sizeof *words, size, file);
        (void)fclose(file);
    }
    return (uint32_t)used;
}

/* In hexadecimal, as the file has it. */
static bool read_start(const char *path, uint32_t *start)
{
    FILE *const file = fopen(path, "r");
    unsigned long number = 0U;
    const bool is_read = (file != NULL) && (fscanf(file, "%8lx", &number) == 1);
    if (file != NULL) {
        (void)fclose(file);
    }
    *start = (uint32_t)number;
    return is_read;
}

int main(int argc, char **argv)
{
    uint32_t start = 0U;
    if ((argc != 5) || !read_start(argv[3], &start)) {
        (void)fprintf(stderr, "usage: replay image.bin events.bin start.mem RESULTS (of a case)\n");
        return 2;
    }
    const uint32_t image_words = read_words(argv[1], image, sizeof image / sizeof *image);
    const uint32_t event_words = read_words(argv[2], events, sizeof events / sizeof *events);
    vpr_design_t design;
    const bool opened = vpr_open(&design, image, image_words * 4U) &&
                        (vpr_ram_bytes(&design) <= (sizeof ram - GUARD));
    const uint32_t ram_bytes = opened ? vpr_ram_bytes(&design) : 0U;
    (void)memset(&ram[ram_bytes / 4U], CANARY, GUARD);
    const uint32_t written =
        vpr_replay(image, image_words * 4U, (const vpr_event_t *)(const void *)events,
                   event_words / 2U, 1U, start, ram, ram_bytes, out,
                   (uint32_t)(sizeof out / sizeof *out));
    for (size_t at = ram_bytes; at < (ram_bytes + GUARD); at++) {
        if (((const uint8_t *)ram)[at] != CANARY) {
            (void)fprintf(stderr, "replay: byte %lu behind the RAM was written\n",
                          (unsigned long)(at - ram_bytes));
            return 1;
        }
    }
    FILE *const file = fopen(argv[4], "wb");
    if ((written == 0U) || (file == NULL)) {
        (void)fprintf(stderr, "replay: the image is refused, or the results cannot be written\n");
        return 1;
    }
    const bool complete = fwrite(out, sizeof *out, written, file) == written;
    return ((fclose(file) == 0) && complete) ? 0 : 1;
}
