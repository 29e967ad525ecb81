#include "evpr_drive.h"

static uint32_t send(evpr_t *e, uint32_t most, uint8_t *out)
{
    uint32_t sent = 0U;
    while (sent < most) {
        const uint8_t *first;
        uint32_t bytes = evpr_out(e, &first);
        if (bytes == 0U) {
            break;
        }
        bytes = (bytes < (most - sent)) ? bytes : (most - sent);
        for (uint32_t i = 0U; i < bytes; i++) {
            out[sent + i] = first[i];
        }
        evpr_sent(e, bytes);
        sent += bytes;
    }
    return sent;
}

static uint32_t run(evpr_t *e, const evpr_step_t *step, uint8_t *out)
{
    switch (step->what) {
    case EVPR_DO_PUSH:
        return evpr_push(e, step->value, step->pixel & 0xFFFFU, (step->pixel >> 16) & 0x7FFFU,
                         (step->pixel >> 31) != 0U)
                   ? 1U
                   : 0U;
    case EVPR_DO_DROP:
        evpr_drop(e, step->value);
        return 0U;
    case EVPR_DO_POLL:
        evpr_poll(e, step->value);
        return 0U;
    case EVPR_DO_FLUSH:
        return evpr_flush(e, step->value) ? 1U : 0U;
    default:
        return send(e, step->value, out);
    }
}

uint32_t evpr_drive(const evpr_setup_t *setup, const evpr_step_t *steps, uint32_t count,
                    uint8_t *buffer, evpr_done_t *done, uint8_t *out)
{
    evpr_t e;
    const evpr_config_t config = {
        .buffer = buffer,
        .buffer_bytes = setup->buffer_bytes,
        .frame_bytes = setup->frame_bytes,
        .boot = (uint16_t)setup->boot,
        .event_bytes = (uint8_t)setup->event_bytes,
        .x_bits = (uint8_t)setup->x_bits,
        .y_bits = (uint8_t)setup->y_bits,
    };
    if (!evpr_init(&e, &config, setup->now)) {
        return 0U;
    }
    /* as if it had run for long: the first frame is made anew */
    e.sequence = setup->sequence;
    e.dropped = setup->dropped;
    e.at = setup->position;
    e.ready = setup->position;
    e.sent = setup->position;
    (void)evpr_flush(&e, setup->now);

    uint32_t used = 0U;
    for (uint32_t i = 0U; i < count; i++) {
        done[i].result = run(&e, &steps[i], &out[used]);
        done[i].ready = e.ready - setup->position;
        used += (steps[i].what == EVPR_DO_SEND) ? done[i].result : 0U;
    }
    return used + send(&e, setup->buffer_bytes, &out[used]);
}

uint32_t evpr_struct_bytes(void)
{
    return (uint32_t)sizeof(evpr_t);
}
