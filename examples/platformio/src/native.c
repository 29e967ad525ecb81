/* The firmware's program on this computer: run it over the recorded events, print what it found. */
#include <stdio.h>

#define main firmware_main
#include "../../firmware-m4/main.c"
#undef main

int main(void)
{
    if (firmware_main() != 0) {
        (void)fprintf(stderr, "include/map.h holds no map, or one that needs more RAM\n");
        return 1;
    }
    (void)printf("%lu matches, the last one at place %lu\n", (unsigned long)matches,
                 (unsigned long)place);
    return 0;
}
