/* Not part of the firmware: runs the encoder through a script, for tests on every target. */
#ifndef EVPR_DRIVE_H
#define EVPR_DRIVE_H

#include "evpr.h"

enum { EVPR_DO_PUSH, EVPR_DO_DROP, EVPR_DO_POLL, EVPR_DO_FLUSH, EVPR_DO_SEND };

typedef struct {
    uint32_t what;
    uint32_t value; /* push, poll, flush: time; drop: events; send: bytes at most */
    uint32_t pixel; /* push: bit 31: 1 for ON; bits 30..16: row; bits 15..0: column */
} evpr_step_t;

typedef struct {
    uint32_t result; /* push, flush: whether taken; send: bytes sent */
    uint32_t ready;  /* bytes of whole frames so far, modulo 2^32 */
} evpr_done_t;

typedef struct {
    uint32_t buffer_bytes;
    uint32_t frame_bytes;
    uint32_t boot;
    uint32_t event_bytes;
    uint32_t x_bits;
    uint32_t y_bits;
    uint32_t now;
    uint32_t sequence; /* where the counters begin */
    uint32_t dropped;
    uint32_t position; /* in the ring */
} evpr_setup_t;

/* Run the steps; bytes put into `out`, the rest of the ring included; 0 if the configuration is
 * refused. Each sending is from evpr_out to evpr_sent. */
uint32_t evpr_drive(const evpr_setup_t *setup, const evpr_step_t *steps, uint32_t count,
                    uint8_t *buffer, evpr_done_t *done, uint8_t *out);

uint32_t evpr_struct_bytes(void);

#endif
