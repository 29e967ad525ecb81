#include "evpr.h"

#include <stdatomic.h>

#define HEADER_BYTES 20U
#define CHECK_BYTES 4U
#define EMPTY_BYTES (HEADER_BYTES + CHECK_BYTES)
#define VERSION 1U
#define PAUSES_MAX 6U /* before one event: a new frame takes fewer bytes than more of them */
#define FULL_CODE 255U

/* CRC-32 of Ethernet, half a byte at a time: 64 bytes of table, not 1024. */
static const uint32_t crc_table[16] = {
    0x00000000U, 0x1DB71064U, 0x3B6E20C8U, 0x26D930ACU, 0x76DC4190U, 0x6B6B51F4U,
    0x4DB26158U, 0x5005713CU, 0xEDB88320U, 0xF00F9344U, 0xD6D6A3E8U, 0xCB61B38CU,
    0x9B64C2B0U, 0x86D3D2D4U, 0xA00AE278U, 0xBDBDF21CU};

/* Write the lowest bytes of a word, stuffed, and take them into the checksum. A code says how far
 * it is to the next zero, which it replaces: it is written when that is known. */
static void put(evpr_t *e, uint32_t word, uint32_t bytes)
{
    uint8_t *const buffer = e->buffer;
    const uint32_t mask = e->mask;
    uint32_t at = e->at;
    uint32_t code_at = e->code_at;
    uint32_t crc = e->crc;

    for (uint32_t i = 0U; i < bytes; i++) {
        const uint32_t byte = word & 0xFFU;
        word >>= 8;
        crc ^= byte;
        crc = (crc >> 4) ^ crc_table[crc & 15U];
        crc = (crc >> 4) ^ crc_table[crc & 15U];
        if (byte != 0U) {
            buffer[at & mask] = (uint8_t)byte;
            at++;
        }
        if ((byte == 0U) || ((at - code_at) == FULL_CODE)) {
            buffer[code_at & mask] = (uint8_t)(at - code_at);
            code_at = at;
            at++;
        }
    }
    e->at = at;
    e->code_at = code_at;
    e->crc = crc;
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
    e->code_at = e->at;
    e->at++;
    e->crc = 0xFFFFFFFFU;
    put(e, e->head, 4U);
    put(e, e->sequence, 4U);
    put(e, e->dropped, 4U);
    put(e, (uint32_t)e->time, 4U);
    put(e, (uint32_t)(e->time >> 32), 4U);
    return true;
}

/* End a frame, and hand it to the consumer. */
static void end(evpr_t *e, uint32_t now)
{
    put(e, ~e->crc, CHECK_BYTES);
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
    e->pause = (1U << ((8U * c->event_bytes) - time_at)) - 1U;
    e->longest_pause = (1U << time_at) - 1U;
    e->sequence = 0U;
    e->dropped = 0U;
    e->left = 0U;
    e->at = 0U;
    e->ready = 0U;
    e->sent = 0U;
    return empty_frame(e, now);
}

/* Bytes of the event's word and of the pauses before it; no fewer than fit any frame where there
 * would be too many. */
static uint32_t bytes_of(const evpr_t *e, uint32_t step)
{
    uint32_t bytes = e->event_bytes;
    if (step >= e->pause) {
        uint32_t rest = step;
        for (uint32_t i = 0U; i < PAUSES_MAX; i++) {
            bytes += e->event_bytes;
            if (rest <= e->longest_pause) {
                return bytes;
            }
            rest -= e->longest_pause;
        }
        bytes = EVPR_MAX_FRAME;
    }
    return bytes;
}

bool evpr_push(evpr_t *e, uint32_t t, uint32_t x, uint32_t y, bool on)
{
    uint32_t step = step_to(e, t);
    uint32_t bytes = bytes_of(e, step);
    const uint32_t now = (uint32_t)e->time + step;

    if (((x >> e->x_bits) | (y >> e->y_bits)) != 0U) {
        e->dropped++;
        return false;
    }
    if ((e->left != 0U) &&
        ((bytes > e->left) || ((now - e->first) >= (EVPR_FRAME_US - EVPR_POLL_US)))) {
        end(e, now);
    }
    e->time += step;
    if (e->left == 0U) {
        if (!begin(e, EMPTY_BYTES + e->words_bytes)) {
            e->dropped++;
            return false;
        }
        e->left = e->words_bytes;
        e->first = now;
        step = 0U;
        bytes = e->event_bytes;
    }
    const uint32_t time_at = (uint32_t)e->x_bits + e->y_bits + 1U;
    if (step >= e->pause) {
        while (step != 0U) {
            const uint32_t wait = (step < e->longest_pause) ? step : e->longest_pause;
            put(e, (e->pause << time_at) | wait, e->event_bytes);
            step -= wait;
        }
    }
    const uint32_t polarity = on ? (1U << (time_at - 1U)) : 0U;
    put(e, (step << time_at) | polarity | (y << e->x_bits) | x, e->event_bytes);
    e->sequence++;
    e->left -= bytes;
    if (e->left < e->event_bytes) {
        end(e, now);
    }
    return true;
}

void evpr_drop(evpr_t *e, uint32_t events)
{
    e->dropped += events;
}

/* Whether `wait` will have passed before the next poll; not if `since` is a time to come. */
static bool due(uint32_t now, uint32_t since, uint32_t wait)
{
    const uint32_t age = now - since;
    return ((age >> 31) == 0U) && (age >= (wait - EVPR_POLL_US));
}

void evpr_poll(evpr_t *e, uint32_t now)
{
    if (e->left != 0U) {
        if (due(now, e->first, EVPR_FRAME_US)) {
            end(e, now);
        }
    } else if (due(now, e->last, EVPR_SILENCE_US)) {
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
