/* From reset to main: the vectors, initial values of variables, and zeros. */
#include <stdint.h>

typedef void (*handler_t)(void);

/* of m4.ld */
extern uint32_t stack_top[];
extern uint32_t data_load[];
extern uint32_t data_start[];
extern uint32_t data_end[];
extern uint32_t bss_start[];
extern uint32_t bss_end[];

int main(void);
void reset(void);
void finished(void);

/* Every fault ends here too, where a debugger finds it. */
__attribute__((noinline)) void finished(void)
{
    for (;;) {
        __asm__ volatile("nop"); /* wfi on a board */
    }
}

void reset(void)
{
    /* volatile: no compiler makes it a call of a library that is not here */
    const volatile uint32_t *from = data_load;
    for (volatile uint32_t *to = data_start; to != data_end; to++) {
        *to = *from;
        from++;
    }
    for (volatile uint32_t *to = bss_start; to != bss_end; to++) {
        *to = 0U;
    }
    (void)main();
    finished();
}

struct vectors {
    uint32_t *stack;
    handler_t handlers[15];
};

extern const struct vectors vectors;
__attribute__((section(".vectors"), used)) const struct vectors vectors = {
    stack_top,
    {reset, finished, finished, finished, finished, finished, finished, finished, finished,
     finished, finished, finished, finished, finished, finished},
};
