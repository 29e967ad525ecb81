/* The firmware's program in QEMU (make run): it prints its matches by semihosting, and whether
 * the vectors have the same ones, and ends. */
#define main firmware_main
#include "main.c"
#undef main

enum { WRITE = 4, EXIT = 0x18 };
#define WITHOUT_ERROR ((const void *)0x20026)
#define WITH_ERROR ((const void *)0x20024)

static void semihost(uint32_t operation, const void *of)
{
    register uint32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = of;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

static void write_number(uint32_t number)
{
    char text[11] = {0};
    char *first = &text[10];
    do {
        first--;
        *first = (char)('0' + (number % 10U));
        number /= 10U;
    } while (number != 0U);
    semihost(WRITE, first);
}

static void write_matches(uint32_t number, uint32_t last)
{
    write_number(number);
    semihost(WRITE, " matches, the last one at place ");
    write_number(last);
}

int main(void)
{
    uint32_t number = 0U;
    uint32_t last = 0U;
    if (firmware_main() != 0) {
        semihost(WRITE, "map.h holds no map, or one that needs more RAM\n");
        semihost(EXIT, WITH_ERROR);
    }
    /* records are kind, number of fields, fields: of a match (kind 3) place is 1, accepted 6 */
    for (uint32_t i = 0U; i < (CASE_EXPECTED_BYTES / 4U); i += 2U + case_expected[i + 1U]) {
        if ((case_expected[i] == 3U) && (case_expected[i + 8U] != 0U)) {
            last = case_expected[i + 3U];
            number++;
        }
    }
    write_matches(matches, place);
    if ((matches == number) && (place == last)) {
        semihost(WRITE, ", as in the vectors\n");
        semihost(EXIT, WITHOUT_ERROR);
    }
    semihost(WRITE, "; the vectors have ");
    write_matches(number, last);
    semihost(WRITE, "\n");
    semihost(EXIT, WITH_ERROR);
    return 0;
}
