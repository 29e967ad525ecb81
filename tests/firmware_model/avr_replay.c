/* Replays a case on an ATmega1284P, whose `int` has 16 bits, and writes each record of a window or a
 * match to its serial port, as hexadecimal words. The case lies in flash (case_flash.h); the image is
 * copied to RAM first, because a pointer of this processor does not reach its flash. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>

#include "case_flash.h"
#include "vpr.h"

static _Alignas(16) uint32_t image[IMAGE_BYTES / 4U];
static _Alignas(16) uint32_t ram[RAM_BYTES / 4U];

static void put(char sign)
{
    while ((UCSR0A & _BV(UDRE0)) == 0) {
    }
    UDR0 = (uint8_t)sign;
}

static void put_word(uint32_t word, char behind)
{
    for (uint8_t i = 0; i < 8; i++) {
        put("0123456789abcdef"[(word >> (28 - (4 * i))) & 15U]);
    }
    put(behind);
}

static void end_window(const vpr_design_t *d, vpr_state_t *s, uint32_t events)
{
    vpr_match_t m;
    vpr_window_end(d, s);
    put('w');
    put_word(s->windows - 1U, ' ');
    put_word(events, ' ');
    for (uint32_t i = 0; i < d->slots; i++) {
        put_word(s->query[i], (i == (d->slots - 1U)) ? '\n' : ' ');
    }
    if (vpr_match_places(d, s, &m)) {
        put('m');
        put_word(m.window, ' ');
        put_word(m.place, ' ');
        put_word(m.sum, ' ');
        put_word(m.second, ' ');
        put_word(m.second_sum, ' ');
        put_word(m.ties, ' ');
        put_word(m.accepted, (d->steps != 0U) ? ' ' : '\n');
        if (d->steps != 0U) {
            put_word(m.trust, '\n');
        }
    }
}

int main(void)
{
    vpr_design_t design;
    vpr_state_t state;
    UCSR0B = _BV(TXEN0);
    memcpy_P(image, case_image, IMAGE_BYTES);
    if (!vpr_open(&design, image, IMAGE_BYTES) || (vpr_ram_bytes(&design) != RAM_BYTES)) {
        put('r');
    } else {
        vpr_reset(&design, &state, ram, CASE_START);
        for (uint32_t i = 0; i < EVENTS; i++) {
            vpr_event_t event;
            memcpy_P(&event, &case_events[2U * i], sizeof event);
            const vpr_event_t *next = &event;
            while (next == &event) {
                const vpr_status_t status = vpr_events(&design, &state, &next, &event + 1);
                if (status == VPR_WINDOW_ENDS) {
                    end_window(&design, &state, i + (uint32_t)(next - &event));
                }
            }
        }
    }
    put('.');
    put('\n');
    cli();
    sleep_mode(); /* the simulator ends */
    return 0;
}
