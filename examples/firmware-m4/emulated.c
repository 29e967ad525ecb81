/* The firmware's program in QEMU (make run): it says by semihosting what it found, and ends. */
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

int main(void)
{
    if (firmware_main() != 0) {
        semihost(WRITE, "map.h holds no map, or one that needs more RAM\n");
        semihost(EXIT, WITH_ERROR);
    }
    write_number(matches);
    semihost(WRITE, " matches, the last one at place ");
    write_number(place);
    semihost(WRITE, "\n");
    semihost(EXIT, WITHOUT_ERROR);
    return 0;
}
