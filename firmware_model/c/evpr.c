#include "evpr.h"

#include <stdatomic.h>

#include "crc.h"

#define HEADER_BYTES 20U
#define CHECK_BYTES 4U
#define EMPTY_BYTES (HEADER_BYTES + CHECK_BYTES)
#define VERSION 1U
#define PAUSES_MAX 6U /* before one event: a new frame takes fewer bytes than more of them */
#define FULL_CODE 255U
/* the next poll may come too late for a frame that is older, or a longer silence */
#define FRAME_AGE (EVPR_FRAME_US - EVPR_POLL_US)
#define SILENCE (EVPR_SILENCE_US - EVPR_POLL_US)

/* Write the lowest bytes of a word, stuffed. A code says how far it is to the next zero, which it
 * replaces: it is written when that is known. */
static void stuff(evpr_t *e, uint32_t word, uint32_t bytes)
{
    uint8_t *const buffer = e->buffer;
    const uint32_t mask = e->mask;
    uint32_t at = e->at;
    uint32_t full_at = e->code_at + FULL_CODE;

    for (uint32_t i = 0U; i < bytes; i++) {
        const uint32_t byte = word & 0xFFU;
        word >>= 8;
        if (byte != 0U) {
            buffer[at & mask] = (uint8_t)byte;
            at++;
        }
        if ((byte == 0U) || (at == full_at)) {
            const uint32_t code_at = full_at - FULL_CODE;
            buffer[code_at & mask] = (uint8_t)(at - code_at);
            full_at = at + FULL_CODE;
            at++;
        }
    }
    e->at = at;
    e->code_at = full_at - FULL_CODE;
}

static void put(evpr_t *e, uint32_t word, uint32_t bytes)
{
    e->crc = crc_after(e->crc, word, bytes);
    stuff(e, word, bytes);
}

/* Begin a frame, if the ring has room for one of so many bytes: then none ever ends for want of
 * room, and a line that is too slow carries long frames, not many short ones. */
static bool begin(evpr_t *e, uint32_t bytes)
{
    const uint32_t used = e->at - e->sent;
    if ((used + EVPR_STUFFED(bytes)) > (e->mask + 1U)) {
        return false;
    }
    atomic_thread_fence(memory_order_acquire); /* what is overwritten now has been sent */
    const uint32_t header[] = {e->head, e->sequence, e->dropped, (uint32_t)e->time,
                               (uint32_t)(e->time >> 32)};
    e->code_at = e->at;
    e->at++;
    e->crc = 0xFFFFFFFFU;
    for (uint32_t i = 0U; i < (HEADER_BYTES / 4U); i++) {
        put(e, header[i], 4U);
    }
    return true;
}

/* End a frame, and hand it to the consumer. */
static void end(evpr_t *e, uint32_t now)
{
    stuff(e, ~e->crc, CHECK_BYTES);
    e->buffer[e->code_at & e->mask] = (uint8_t)(e->at - e->code_at);
    e->buffer[e->at & e->mask] = 0U;
    e->at++;
    e->left = 0U;
    e->last = now;
    atomic_thread_fence(memory_order_release); /* the bytes are there before they are ready */
    e->ready = e->at;
}

/* Microseconds since what was told last; 0 for a time before that. */
static uint32_t step_to(const evpr_t *e, uint32_t t)
{
    const uint32_t step = t - (uint32_t)e->time;
    return ((step >> 31) == 0U) ? step : 0U;
}

static bool empty_frame(evpr_t *e, uint32_t now)
{
    e->time += step_to(e, now);
    if (!begin(e, EMPTY_BYTES)) {
        return false;
    }
    end(e, now);
    return true;
}

bool evpr_init(evpr_t *e, const evpr_config_t *c, uint32_t now)
{
    const uint32_t time_at = (uint32_t)c->x_bits + c->y_bits + 1U;
    const uint32_t size = c->buffer_bytes;
    if (((c->event_bytes != 3U) && (c->event_bytes != 4U)) || (c->x_bits < 1U) ||
        (c->x_bits > 15U) || (c->y_bits < 1U) || (c->y_bits > 15U) ||
        ((time_at + 1U) > (8U * c->event_bytes))) {
        return false;
    }
    if ((c->frame_bytes < (EMPTY_BYTES + c->event_bytes)) || (c->frame_bytes > EVPR_MAX_FRAME) ||
        ((size & (size - 1U)) != 0U) || (size < EVPR_STUFFED(c->frame_bytes))) {
        return false;
    }
    e->time = now;
    e->buffer = c->buffer;
    e->mask = size - 1U;
    e->words_bytes = c->frame_bytes - EMPTY_BYTES;
    e->head = (VERSION << 4) | c->event_bytes | ((uint32_t)c->x_bits << 8) |
              ((uint32_t)c->y_bits << 12) | ((uint32_t)c->boot << 16);
    e->event_bytes = c->event_bytes;
    e->x_bits = c->x_bits;
    e->y_bits = c->y_bits;
    e->time_at = (uint8_t)time_at;
    e->pause = ((uint32_t)1U << ((8U * c->event_bytes) - time_at)) - 1U;
    e->longest_pause = ((uint32_t)1U << time_at) - 1U;
    e->sequence = 0U;
    e->dropped = 0U;
    e->left = 0U;
    e->at = 0U;
    e->ready = 0U;
    e->sent = 0U;
    return empty_frame(e, now);
}

/* Pauses that a step takes, at most one more than are made. */
static uint32_t pauses_of(const evpr_t *e, uint32_t step)
{
    uint32_t pauses = 1U;
    while ((step > e->longest_pause) && (pauses <= PAUSES_MAX)) {
        step -= e->longest_pause;
        pauses++;
    }
    return pauses;
}

/* Tell the time of an event that no word in the open frame can: by pauses, if they fit, or by the
 * base time of a new frame. */
static bool tell_time(evpr_t *e, uint32_t step)
{
    const uint32_t now = (uint32_t)e->time + step;
    e->time += step;
    if (e->left != 0U) {
        const uint32_t pauses = pauses_of(e, step);
        const bool fit = (pauses <= PAUSES_MAX) && (((pauses + 1U) * e->event_bytes) <= e->left);
        if (fit && ((now - e->first) < FRAME_AGE)) {
            while (step != 0U) {
                const uint32_t wait = (step < e->longest_pause) ? step : e->longest_pause;
                put(e, (e->pause << e->time_at) | wait, e->event_bytes);
                step -= wait;
            }
            e->left -= pauses * e->event_bytes;
            return true;
        }
        end(e, now);
    }
    if (!begin(e, EMPTY_BYTES + e->words_bytes)) {
        return false;
    }
    e->left = e->words_bytes;
    e->first = now;
    return true;
}

bool evpr_push(evpr_t *e, uint32_t t, uint32_t x, uint32_t y, bool on)
{
    uint32_t step = step_to(e, t);
    const uint32_t age = ((uint32_t)e->time + step) - e->first;

    if (((x >> e->x_bits) | (y >> e->y_bits)) != 0U) {
        e->dropped++;
        return false;
    }
    if ((e->left == 0U) || (step >= e->pause) || (age >= FRAME_AGE)) {
        if (!tell_time(e, step)) {
            e->dropped++;
            return false;
        }
        step = 0U;
    }
    e->time += step;
    const uint32_t pixel = x | (y << e->x_bits);
    const uint32_t polarity = on ? ((uint32_t)1U << (e->time_at - 1U)) : 0U;
    put(e, pixel | polarity | (step << e->time_at), e->event_bytes);
    e->sequence++;
    e->left -= e->event_bytes;
    if (e->left < e->event_bytes) {
        end(e, (uint32_t)e->time);
    }
    return true;
}

void evpr_drop(evpr_t *e, uint32_t events)
{
    e->dropped += events;
}

/* Whether so much time has passed; not if `since` is a time to come. */
static bool passed(uint32_t now, uint32_t since, uint32_t wait)
{
    const uint32_t age = now - since;
    return ((age >> 31) == 0U) && (age >= wait);
}

void evpr_poll(evpr_t *e, uint32_t now)
{
    const bool silent = passed(now, e->last, SILENCE);
    if (e->left != 0U) {
        if (silent || passed(now, e->first, FRAME_AGE)) {
            end(e, now);
        }
    } else if (silent) {
        (void)empty_frame(e, now); /* without room for it, there is no silence on the line */
    } else {
        /* nothing to say yet */
    }
}

bool evpr_flush(evpr_t *e, uint32_t now)
{
    if (e->left != 0U) {
        end(e, now);
    }
    return empty_frame(e, now);
}

uint32_t evpr_out(const evpr_t *e, const uint8_t **first)
{
    const uint32_t sent = e->sent;
    const uint32_t whole = e->ready - sent;
    const uint32_t to_end = (e->mask + 1U) - (sent & e->mask);
    atomic_thread_fence(memory_order_acquire); /* the bytes are read after `ready` */
    *first = &e->buffer[sent & e->mask];
    return (whole < to_end) ? whole : to_end;
}

void evpr_sent(evpr_t *e, uint32_t bytes)
{
    atomic_thread_fence(memory_order_release); /* the bytes are read before they are given back */
    e->sent += bytes;
}
