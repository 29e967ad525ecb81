/* A camera bridge, whole: an interrupt queues events, the main loop frames them, a DMA sends them.
 *
 * What lies under "the board" stands in for hardware: a camera with bursts, a line of 12 Mbaud that
 * is too slow for them, and a clock. Replace it by yours. On a computer this runs for 0.4 s of its
 * own time and writes to its output what the line would carry:
 *
 *     cc -std=c11 evpr.c evpr_example.c -o example && ./example > frames.bin
 */
#include <stdatomic.h>
#include <stdio.h>

#include "evpr.h"

static uint32_t micros(void);                                 /* a timer of 32 bits */
static void uart_start(const uint8_t *first, uint32_t bytes); /* uart_done comes at the end */
static bool running(void);

/* ---- the firmware ---- */

#define QUEUE 256U /* events; a power of two */

typedef struct {
    uint32_t t;
    uint16_t x;
    uint16_t y;
    bool on;
} event_t;

static event_t queue[QUEUE];
static volatile uint32_t queued;
static volatile uint32_t taken;
static volatile uint32_t missed;

static evpr_t evpr;
static uint8_t ring[4096];
static volatile bool host_listens;
static volatile uint32_t sending; /* bytes that the DMA is at; 0: it rests */

/* The camera's interrupt: it has an event. */
static void camera_event(uint32_t t, uint16_t x, uint16_t y, bool on)
{
    const uint32_t at = queued;
    if ((at - taken) == QUEUE) {
        missed++;
    } else {
        queue[at % QUEUE] = (event_t){t, x, y, on};
        atomic_thread_fence(memory_order_release);
        queued = at + 1U;
    }
}

static void send_more(void)
{
    const uint8_t *first;
    const uint32_t bytes = evpr_out(&evpr, &first);
    if (bytes != 0U) {
        sending = bytes;
        uart_start(first, bytes);
    }
}

/* The DMA's interrupt: all of it has been sent. */
static void uart_done(void)
{
    evpr_sent(&evpr, sending);
    sending = 0U;
    send_more();
}

/* The UART's interrupt: the host has sent a byte. It sends 00 when it opens the line, and twice a
 * second while it hears nothing, so that neither side has to start first: a device that starts
 * later, or again after a dip of its supply, waits half a second at most. Without a wire from the
 * host, leave out the wait in main. */
static void uart_byte(uint8_t byte)
{
    if (byte == 0U) {
        host_listens = true;
    }
}

/* Frame what the camera's interrupt has queued, and count what it could not queue. */
static void take_events(void)
{
    static uint32_t told;
    const uint32_t lost = missed;
    evpr_drop(&evpr, lost - told);
    told = lost;
    while (taken != queued) {
        atomic_thread_fence(memory_order_acquire);
        const event_t *const event = &queue[taken % QUEUE];
        (void)evpr_push(&evpr, event->t, event->x, event->y, event->on);
        atomic_thread_fence(memory_order_release);
        taken = taken + 1U;
    }
}

int main(void)
{
    const evpr_config_t config = {
        .buffer = ring,
        .buffer_bytes = sizeof ring,
        .frame_bytes = 1024U,
        .boot = 1U, /* from flash, or a random number */
        .event_bytes = 4U,
        .x_bits = 9U,
        .y_bits = 9U,
    };
    while (!host_listens) {
        (void)running(); /* the camera is still off: nobody would get its events */
    }
    if (!evpr_init(&evpr, &config, micros())) {
        return 1;
    }
    while (running()) {
        const uint32_t now = micros(); /* before the queue is read */
        take_events();
        evpr_poll(&evpr, now);
        if (sending == 0U) { /* so that no interrupt of the DMA can come between */
            send_more();
        }
    }
    /* a device that is switched off in good order says what it did until then */
    take_events();
    while (!evpr_flush(&evpr, micros())) {
        (void)running(); /* until there is room */
    }
    if (sending == 0U) {
        send_more();
    }
    while (sending != 0U) {
        (void)running();
    }
    return 0;
}

/* ---- the board: a simulation ---- */

static uint32_t now_us;
static uint32_t made;
static const uint8_t *line;
static uint32_t line_left;

static uint32_t micros(void)
{
    return now_us;
}

static void uart_start(const uint8_t *first, uint32_t bytes)
{
    line = first;
    line_left = bytes;
}

/* In the first 20 ms an event each microsecond, then one each 50 us, then silence; the line carries
 * 6 bytes in 5 us. */
static bool running(void)
{
    if (!host_listens) {
        uart_byte(0U);
        return true;
    }
    for (uint32_t i = 0U; i < 5U; i++) {
        now_us++;
        const uint32_t t = now_us;
        if ((t <= 20000U) || ((t <= 200000U) && ((t % 50U) == 0U))) {
            camera_event(t, (uint16_t)(t % 346U), (uint16_t)(t % 260U), (t & 1U) != 0U);
            made++;
        }
    }
    if (line_left != 0U) {
        const uint32_t bytes = (line_left < 6U) ? line_left : 6U;
        (void)fwrite(line, 1U, bytes, stdout);
        line = &line[bytes];
        line_left -= bytes;
        if (line_left == 0U) {
            uart_done();
        }
    }
    if (now_us == 400000U) {
        (void)fprintf(stderr, "%lu events, %lu dropped\n", (unsigned long)made,
                      (unsigned long)(evpr.dropped + missed));
    }
    return now_us < 400000U;
}
