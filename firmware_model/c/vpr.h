/* Visual place recognition from the event counts of a few pixels.
 *
 * Reference firmware: portable C11, no heap, no floating point, no library. It computes what
 * firmware_model specifies, bit for bit; docs/firmware.md says what that is.
 *
 * One image in flash (see vpr_open) holds the design and its tables; one block of RAM from the
 * caller holds the state. The caller's loop is
 *
 *     status = vpr_event(&design, &state, &event);
 *     while (status == VPR_END_THEN_RETRY) {          time windows: the event lies behind the end
 *         vpr_window_end(&design, &state);
 *         found = vpr_match_places(&design, &state, &match);
 *         status = vpr_event(&design, &state, &event);
 *     }
 *     if (status == VPR_END_NOW) { ... the same two calls, and no retry ... }
 */
#ifndef VPR_H
#define VPR_H

#include <stdbool.h>
#include <stdint.h>

#define VPR_MAGIC 0x49525056U /* "VPRI" */
#define VPR_VERSION 1U
#define VPR_HEADER_WORDS 28U
#define VPR_NONE 0xFFFFFFFFU

/* As it arrives: 8 bytes, two little-endian words {time, polarity:1 row:15 column:16}. */
typedef struct {
    uint32_t t; /* microseconds; the upper bits beyond timestamp_bits are ignored */
    uint16_t x;
    uint16_t y_on; /* bit 15: 1 for ON; bits 14..0: row */
} vpr_event_t;

/* Constants: read from the image once, and the same ever after. */
typedef struct {
    const uint16_t *displacement; /* [height]: where a row begins in the look-up */
    const uint32_t *lookup;       /* [lookup_mask + 1]: owner row << 16 | slot */
    const uint8_t *code;          /* [tables][count_max + 1]: code of each count */
    const uint8_t *code_table;    /* [slots]: which of the tables a counter uses */
    const uint8_t *places;        /* [places][stride]: codes, padded with zeros */
    uint32_t width;
    uint32_t height;
    uint32_t lookup_mask;
    uint32_t off_slot; /* added to the slot of an OFF event: 0, or J where polarities are apart */
    uint32_t slots;
    uint32_t stride;
    uint32_t count_max;
    int32_t open_until; /* elapsed time of a window's last microsecond, shifted */
    uint32_t time_shift;
    uint32_t tau;    /* 0 for windows by count */
    uint32_t budget; /* 0 for windows by time */
    uint32_t place_count;
    uint32_t length;
    uint32_t exclusion;
    uint32_t ratio_denominator; /* 0: accept by margin */
    uint32_t accept;            /* margin, or numerator of the ratio */
} vpr_design_t;

typedef struct {
    uint16_t *counts;  /* [slots] */
    uint8_t *query;    /* [stride]: codes of the window that ended last */
    uint16_t *history; /* [length][place_count]: distances of the last windows, a ring */
    uint32_t *delay;   /* [exclusion + 1]: sums still within the exclusion zone, a ring */
    uint32_t start;    /* of the open window */
    uint32_t counted;  /* events at selected pixels in the open window */
    uint32_t windows;  /* ended so far */
    uint32_t seen;     /* the same, at most length */
    uint32_t newest;   /* row of history */
} vpr_state_t;

typedef enum {
    VPR_TAKEN = 0,          /* nothing more to do */
    VPR_END_NOW = 1,        /* taken; it was the window's last event */
    VPR_END_THEN_RETRY = 2  /* not taken: end the window first, then give the event again */
} vpr_status_t;

typedef struct {
    uint32_t window;     /* number of the window that ended last, from 0 */
    uint32_t place;      /* where the sequence ends on the map */
    uint32_t sum;        /* its distance, over the whole sequence */
    uint32_t second;     /* best place outside the exclusion zone, or VPR_NONE */
    uint32_t second_sum; /* VPR_NONE where there is none */
    uint32_t ties;       /* further places at the same smallest distance */
    bool accepted;
} vpr_match_t;

/* Check an image and read its design. False: it is none, of another version, or beyond the limits
 * of this firmware (codes of at most 8 bits, a distance of at most 16, and comparisons of at most
 * 32). `image` is aligned to 16 bytes. */
bool vpr_open(vpr_design_t *d, const uint32_t *image, uint32_t image_bytes);

/* Bytes of RAM that the state needs beside vpr_state_t. */
uint32_t vpr_ram_bytes(const vpr_design_t *d);

/* Begin: all counters zero, the first window opens at `start`. `ram` is aligned to 16 bytes. */
void vpr_reset(const vpr_design_t *d, vpr_state_t *s, uint32_t *ram, uint32_t start);

/* Slot of the counter that an event belongs to, or VPR_NONE. */
uint32_t vpr_slot(const vpr_design_t *d, const vpr_event_t *e);

/* Take one event, in constant time. */
vpr_status_t vpr_event(const vpr_design_t *d, vpr_state_t *s, const vpr_event_t *e);

/* End the open window: its codes go to `query`, its counters are cleared, the next one opens. */
void vpr_window_end(const vpr_design_t *d, vpr_state_t *s);

/* Compare the window that ended last with every place. False: fewer than `length` windows so far,
 * and no match. To be called once after every vpr_window_end. */
bool vpr_match_places(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m);

#endif
