/* Run golden vectors on a board: `edge-vpr golden verify VECTORS --port PORT` on the computer.
 *
 * The port is UART 0 of Arm's MPS2 boards and of their emulation (qemu-system-arm -M mps2-an386).
 * Replace the part "the board" by your own.
 */
#include "replay.h"

/* ---- the board: a port of 115,200 baud ---- */

#define UART ((volatile uint32_t *)0x40004000U)
enum { DATA, STATE, CONTROL, BAUD = 4 };
#define TX_FULL 1U
#define RX_FULL 2U
#define BOTH_WAYS 3U
#define CLOCK_HZ 25000000U

static uint8_t get(void)
{
    while ((UART[STATE] & RX_FULL) == 0U) {
    }
    return (uint8_t)UART[DATA];
}

static void put(uint8_t byte)
{
    while ((UART[STATE] & TX_FULL) != 0U) {
    }
    UART[DATA] = byte;
}

/* ---- the firmware ---- */

static _Alignas(16) uint32_t memory[(56U * 1024U) / sizeof(uint32_t)]; /* images and states */

int main(void)
{
    const vpr_line_t line = {get, put};
    UART[BAUD] = CLOCK_HZ / 115200U;
    UART[CONTROL] = BOTH_WAYS;
    for (;;) {
        vpr_replay_line(&line, memory, (uint32_t)sizeof memory);
    }
}
