/* `evpr_drive SETUP STEPS DONE OUT`: run a script on this computer. */
#include <stdio.h>
#include <stdlib.h>

#include "evpr_drive.h"

static void *read_file(const char *path, size_t *size)
{
    FILE *const file = fopen(path, "rb");
    void *bytes = NULL;
    *size = 0U;
    if (file != NULL) {
        (void)fseek(file, 0L, SEEK_END);
        const long end = ftell(file);
        rewind(file);
        bytes = (end < 0L) ? NULL : malloc((size_t)end + 1U);
        if (bytes != NULL) {
            *size = fread(bytes, 1U, (size_t)end, file);
        }
        (void)fclose(file);
    }
    return bytes;
}

static bool write_file(const char *path, const void *bytes, size_t size)
{
    FILE *const file = fopen(path, "wb");
    const bool complete = (file != NULL) && (fwrite(bytes, 1U, size, file) == size);
    return (file != NULL) && (fclose(file) == 0) && complete;
}

int main(int argc, char **argv)
{
    if (argc != 5) {
        (void)fprintf(stderr, "usage: evpr_drive SETUP STEPS DONE OUT\n");
        return 2;
    }
    size_t setup_bytes;
    size_t steps_bytes;
    evpr_setup_t *const setup = read_file(argv[1], &setup_bytes);
    evpr_step_t *const steps = read_file(argv[2], &steps_bytes);
    if ((setup == NULL) || (setup_bytes != sizeof *setup) || (steps == NULL)) {
        (void)fprintf(stderr, "evpr_drive: setup or steps cannot be read\n");
        return 1;
    }
    /* each of its own, to the byte, so that a sanitiser sees what is written beyond */
    const size_t count = steps_bytes / sizeof *steps;
    uint8_t *const buffer = malloc(setup->buffer_bytes + (setup->buffer_bytes == 0U));
    evpr_done_t *const done = malloc((count * sizeof *done) + 1U);
    uint8_t *const out = malloc((count * EVPR_STUFFED(64U)) + setup->buffer_bytes + 1U);
    if ((buffer == NULL) || (done == NULL) || (out == NULL)) {
        (void)fprintf(stderr, "evpr_drive: too many steps\n");
        return 1;
    }
    const uint32_t used = evpr_drive(setup, steps, (uint32_t)count, buffer, done, out);
    const bool written = (used != 0U) && write_file(argv[3], done, count * sizeof *done) &&
                         write_file(argv[4], out, used);
    free(setup);
    free(steps);
    free(buffer);
    free(done);
    free(out);
    if (!written) {
        (void)fprintf(stderr, "evpr_drive: refused, or the results cannot be written\n");
        return 1;
    }
    return 0;
}
