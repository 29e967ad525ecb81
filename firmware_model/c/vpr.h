/* Visual place recognition from the event counts of a few pixels.
 *
 * Reference firmware: portable C11, no heap, no floating point, no library. It computes what
 * firmware_model specifies, bit for bit; docs/specification.md says what that is.
 *
 * One image in flash (see vpr_open) holds the design and its tables; one block of RAM from the
 * caller holds the state. The caller's loop is
 *
 *     while (next != end) {                     events as they arrived, one or many
 *         if (vpr_events(&design, &state, &next, end) == VPR_WINDOW_ENDS) {
 *             vpr_window_end(&design, &state);
 *             found = vpr_match_places(&design, &state, &match);
 *         }
 *     }
 */
#ifndef VPR_H
#define VPR_H

#include <stdbool.h>
#include <stdint.h>

#define VPR_MAGIC 0x49525056U /* "VPRI" */
#define VPR_VERSION 4U
#define VPR_HEADER_WORDS 40U
#define VPR_NONE 0xFFFFFFFFU

/* As it arrives: 8 bytes. */
typedef struct {
    uint32_t t;     /* microseconds; the upper bits beyond timestamp_bits are ignored */
    uint32_t pixel; /* bit 31: any, as 1 for ON; bits 30..16: row; bits 15..0: column */
} vpr_event_t;

/* Of the look-up: whose entry it is, and its slot. */
typedef struct {
    uint32_t pixel; /* bits 30..16: row; bits 15..0: column; all ones: nobody's */
    uint32_t slot;
} vpr_entry_t;

/* Constants: read from the image once, and the same ever after. */
typedef struct {
    const uint16_t *displacement; /* [height]: where a row begins in the look-up */
    const vpr_entry_t *lookup;    /* [lookup_mask + 1] */
    const uint8_t *code;          /* [tables][count_max + 1]: code of each count */
    const uint16_t *level;        /* [count_max + 1]: its logarithm, of own-mean codes; else NULL */
    const uint8_t *code_table;    /* [slots]: which of the tables a counter uses */
    const uint8_t *places;        /* [places][stride]: codes, padded with zeros */
    const int8_t *place_activity; /* [places], of the place filter: steps cost what it says */
    const uint16_t *mean;         /* [slots]: where running means start; of other codes unused */
    uint32_t height;
    uint32_t lookup_mask;
    uint32_t slots;
    uint32_t stride;
    uint32_t count_max;
    uint32_t time_scale; /* brings times to 32 bits, so that the clock wraps there; by count: 0 */
    uint32_t tau;        /* scaled; by count: 0 */
    uint32_t budget;     /* events of a window by count; by time: 0 */
    uint32_t place_count;
    uint32_t length;
    uint32_t exclusion;
    uint32_t largest_sum; /* of a sequence that is accepted */
    uint32_t code_max;
    uint32_t steps;   /* of 0, 1 ... places that have a cost, of the place filter; of sequences 0 */
    uint32_t restart; /* cost of jumping to any place (kidnapped robot): 64 suits most routes, 0
                         matches every window alone */
    uint32_t trust;   /* least of the place filter that is accepted, 0 to 368 */
    uint32_t activity; /* where the usual number of events starts, in units of 1/256 */
    bool contrast;     /* own-mean codes are less the mean of their window, too */
} vpr_design_t;

typedef struct {
    uint16_t *counts;  /* [slots] */
    uint8_t *query;    /* [stride]: codes of the window that ended last */
    uint16_t *history; /* [length][place_count]: distances of the last windows, a ring */
    uint32_t *delay;   /* [exclusion + 1]: sums still within the exclusion zone, a ring */
    uint32_t window_end; /* of the open window, scaled */
    uint32_t left;       /* events at selected pixels that the open window still takes */
    uint32_t windows;  /* ended so far */
    uint32_t seen;     /* the same, at most length */
    uint32_t newest;   /* row of history */
    uint32_t usual;    /* events of a window, in units of 1/256 */
    int32_t activity;  /* of the window that ended last, against that: 1/16 octave */
    bool paused;       /* it had hardly any events */
    uint32_t *mean;    /* [slots]: running mean of the logarithm, in units of 1/65536 octave */
    uint32_t mean_shift;
    uint32_t mean_windows; /* until the shift grows */
    uint16_t *metric;      /* [place_count], of the place filter */
    uint16_t *distance;    /* [place_count], of the place filter: of the newest window */
    uint32_t reciprocal; /* of the spread of the window before: scales the evidence */
    uint32_t least;      /* metric */
    uint32_t place;      /* of the match before, or VPR_NONE */
    uint32_t support;    /* of the match before */
    uint32_t residual;   /* evidence against that place */
    uint32_t residual_before; /* of the match before that one */
} vpr_state_t;

typedef enum {
    VPR_ALL_TAKEN = 0,
    VPR_WINDOW_ENDS = 1 /* before the event at `next`, if there is one */
} vpr_status_t;

typedef struct {
    uint32_t window;     /* number of the window that ended last, from 0 */
    uint32_t place;      /* where the sequence ends on the map */
    uint32_t sum;        /* its distance, over the whole sequence; or the metric of the filter */
    uint32_t second;     /* best place outside the exclusion zone, or VPR_NONE */
    uint32_t second_sum; /* VPR_NONE where there is none */
    uint32_t ties;       /* further places at the same smallest distance */
    bool accepted;
    uint32_t trust; /* of the filter: how far to trust it, in units of 1/16 of a metric; else 0 */
} vpr_match_t;

/* Check an image and read its design. False: it is none, of another version, damaged, or beyond the
 * limits of this firmware (codes of at most 8 bits, a distance of at most 16, and comparisons of at
 * most 32); on failure `*d` is undefined. `image` is aligned to 16 bytes, and `image_bytes` of it can be
 * read; both are all that is trusted.
 *
 * True: every word of the header and every entry of the tables is within its range. As long as the
 * image stays as it is, no events, whatever their pixels and times, make the functions below read
 * outside the image and the RAM, write outside the RAM, or run for ever; a single event ends at
 * most (half the clock's period) / tau + 1 windows. Every sum is exact. There is no checksum: an
 * image that was damaged into another valid one (another code of a place) is accepted. */
bool vpr_open(vpr_design_t *d, const uint32_t *image, uint32_t image_bytes);

/* Bytes of RAM that the state needs beside vpr_state_t. */
uint32_t vpr_ram_bytes(const vpr_design_t *d);

/* Begin: all counters zero, the first window opens at `start`. `ram` is aligned to 16 bytes. */
void vpr_reset(const vpr_design_t *d, vpr_state_t *s, uint32_t *ram, uint32_t start);

/* Slot of the counter that an event belongs to, or VPR_NONE. */
uint32_t vpr_slot(const vpr_design_t *d, const vpr_event_t *e);

/* Take the events from `*next` on, until a window ends or there are no more; `*next` is left at the
 * first one that was not taken. Each takes constant time. */
vpr_status_t vpr_events(const vpr_design_t *d, vpr_state_t *s, const vpr_event_t **next,
                        const vpr_event_t *end);

/* End the open window: its codes go to `query`, its counters are cleared, the next one opens. */
void vpr_window_end(const vpr_design_t *d, vpr_state_t *s);

/* Compare the window that ended last with every place. False: fewer than `length` windows so far,
 * and no match; the place filter has always one. To be called once after every vpr_window_end. */
bool vpr_match_places(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m);

#endif
