/* Events over a serial line that the host can account for: the frames of docs/protocol_evpr.md.
 *
 * Portable C11, no heap, no floating point, no library, no division. Bytes are stuffed and their
 * checksum is taken as events come in, straight into a ring that the caller gives, so that nothing
 * is copied and a frame costs no burst of work at its end. The caller's part is
 *
 *     evpr_push(&evpr, t, x, y, on);               each event; timer and camera: the producer
 *     evpr_poll(&evpr, now);                       every millisecond
 *
 *     bytes = evpr_out(&evpr, &first);             the UART or its DMA: the consumer
 *     ...                                          send `bytes` from `first` on, or some of them
 *     evpr_sent(&evpr, bytes);
 *
 * Producer and consumer may interrupt each other anywhere, and may be two cores; the calls of the
 * producer must not interrupt each other, nor those of the consumer. A DMA behind a data cache needs
 * the cache cleaned over what evpr_out gives.
 *
 * Times are 32 bits of microseconds and wrap, as a timer's do: no 64-bit time has to be made in the
 * camera's interrupt. The encoder widens them for the host, which takes a call of evpr_push,
 * evpr_poll or evpr_flush in every 2^31 us (35 minutes). Time does not run backwards on the line: an
 * event earlier than what was told before it, an empty frame's time included, is told with that
 * time. So read the clock, then the camera until it is empty, then poll with what the clock said.
 */
#ifndef EVPR_H
#define EVPR_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define EVPR_MAX_FRAME 8192U /* bytes before stuffing */

#ifndef EVPR_FRAME_US
#define EVPR_FRAME_US 5000U /* a frame is ready when its first event is so old, at the latest */
#endif
#ifndef EVPR_SILENCE_US
#define EVPR_SILENCE_US 100000U /* a frame is ready so long after the last one, at the latest */
#endif
#ifndef EVPR_POLL_US
#define EVPR_POLL_US 1000U /* evpr_poll is called so often, at least */
#endif

/* Bytes on the line of a frame that has n before stuffing, at most. */
#define EVPR_STUFFED(n) ((n) + ((n) >> 7) + 2U)

typedef struct {
    uint8_t *buffer;       /* the ring */
    uint32_t buffer_bytes; /* a power of two, EVPR_STUFFED(frame_bytes) or more; better twice that,
                            * so that one frame can be made while another is sent */
    uint32_t frame_bytes;  /* longest frame before stuffing: room for one event (24 + event_bytes) to
                            * EVPR_MAX_FRAME; a damaged byte costs a frame */
    uint16_t boot;         /* another one at each start of the device */
    uint8_t event_bytes;   /* 3 or 4 */
    uint8_t x_bits;        /* 1 to 15 each; of 8 * event_bytes, two are left for polarity and time */
    uint8_t y_bits;
} evpr_config_t;

/* The state; none of it is the caller's to write, but for a test. */
typedef struct {
    uint64_t time; /* told last, in a word or by an empty frame */
    uint8_t *buffer;
    uint32_t mask;
    uint32_t words_bytes; /* of the longest frame */
    uint32_t head;        /* of a frame: its first four bytes */
    uint8_t event_bytes;
    uint8_t x_bits;
    uint8_t y_bits;
    uint8_t time_at;        /* lowest bit of a word's time */
    uint32_t pause;         /* time field of a pause: all ones */
    uint32_t longest_pause; /* the other bits, all ones */
    uint32_t sequence;      /* events put into frames, modulo 2^32 */
    uint32_t dropped;       /* events that were not, modulo 2^32 */
    uint32_t left;          /* bytes that the open frame still takes; 0: there is none */
    uint32_t first;         /* time of its first event */
    uint32_t last;          /* when the frame before it was ready */
    uint32_t crc;
    /* positions in the ring count on for ever, modulo 2^32 */
    uint32_t at;             /* the next byte */
    uint32_t code_at;        /* the stuffing's open code */
    volatile uint32_t ready; /* end of the frames that are whole: the producer's */
    volatile uint32_t sent;  /* the consumer's */
} evpr_t;

/* Begin, and make an empty frame, which tells the host the time. False: the configuration cannot
 * be. */
bool evpr_init(evpr_t *e, const evpr_config_t *c, uint32_t now);

/* Take an event. False: it is counted as dropped, as the ring has no room for a longest frame or the
 * pixel does not fit the bits. Constant time. */
bool evpr_push(evpr_t *e, uint32_t t, uint32_t x, uint32_t y, bool on);

/* Count events that were dropped elsewhere: in the camera, or in a queue before this. */
void evpr_drop(evpr_t *e, uint32_t events);

/* End the open frame, or make an empty one, if its time has come. */
void evpr_poll(evpr_t *e, uint32_t now);

/* End the open frame, and make an empty one, which tells the count of events and drops until now:
 * before the line is closed, or when the host sends a 0. False: no room for it; try again. */
bool evpr_flush(evpr_t *e, uint32_t now);

/* Bytes of whole frames that can be sent, and where they are: those up to the end of the ring; the
 * next call gives those from its beginning. 0: none. They stay until evpr_sent. */
uint32_t evpr_out(const evpr_t *e, const uint8_t **first);

/* Give back so many bytes of them, in any pieces. */
void evpr_sent(evpr_t *e, uint32_t bytes);

#ifdef __cplusplus
}
#endif

#endif
