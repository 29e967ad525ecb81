/* Visual place recognition from the event counts of a few pixels.
 *
 * Reference firmware: portable C11, no heap, no floating point, no library. It computes what
 * firmware_model specifies, bit for bit; docs/specification.md says what that is.
 *
 * One image in flash (see vpr_open) holds the design and its tables; one block of RAM from the
 * caller holds the state. No function is reentrant: an interrupt fills a queue, from which the caller's
 * loop takes its events. After vpr_open and vpr_reset, this loop is
 *
 *     while (next != end) {                     events as they arrived, one or many
 *         if (vpr_events(&design, &state, &next, end) == VPR_WINDOW_ENDS) {
 *             vpr_window_end(&design, &state);
 *             matched = vpr_match_places(&design, &state, &match);
 *         }
 *     }
 *
 * and, while no events come, once a window:
 *
 *     for (uint32_t due = vpr_time(&design, &state, now); due > 0U; due--) {
 *         vpr_window_end(&design, &state);
 *         matched = vpr_match_places(&design, &state, &match);
 *     }
 */
#ifndef VPR_H
#define VPR_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define VPR_NONE 0xFFFFFFFFU

/* An event as it arrives: 8 bytes. */
typedef struct {
    uint32_t t;     /* microseconds; bits beyond timestamp_bits are ignored */
    uint32_t pixel; /* bit 31: any, as 1 for ON; bits 30..16: row; bits 15..0: column */
} vpr_event_t;

/* An entry of the look-up: its pixel, and the slot of that pixel. */
typedef struct {
    uint32_t pixel; /* as of an event, times 2: bits 31..17: row; 16..1: column; all ones: no pixel */
    uint32_t slot;
} vpr_entry_t;

/* A design, read from the image by vpr_open and constant afterwards. The advice is for who makes the
 * image: `edge-vpr convert` writes all of it from a map. */
typedef struct {
    const uint16_t *displacement; /* [height]: where a row begins in the look-up */
    const vpr_entry_t *lookup;    /* [lookup_mask + 1] */
    const uint16_t *level; /* [1024], of contrast codes: round(256 log2(1 + count)), 0 to 2560 */
    const uint8_t *places; /* [place_count][stride]: codes 0 to code_max, padded with zeros */
    const int8_t *place_activity; /* [place_count], of the filter: 1/16 octave, -128 to 127; from the
                                     reference drive. 0 everywhere if its speed is not known */
    const uint8_t *place_bias; /* [place_count], of the filter: added to distances, 0 to 255; from the
                                  map. 0 everywhere if it is not known */
    const uint16_t *limit; /* [slots], of contrast codes: most events that count in a window, 0 to 1023;
                              from the map. 1023 everywhere counts all */
    const uint16_t *mean; /* [slots], of contrast codes: first running means, 0 to 2560; from the map */
    uint32_t height;      /* rows of the sensor, 1 to 32768 */
    uint32_t lookup_mask; /* entries of the look-up less 1: a power of two up to 65536, less 1 */
    uint32_t slots;       /* selected pixels, 1 to 65535: 100 to 200 suit most routes */
    uint32_t stride;      /* slots rounded up to a multiple of 16: bytes of a row of codes */
    uint32_t count_max;   /* at which a counter saturates: 1023 of contrast codes, else code_max */
    uint32_t time_scale;  /* 2^(32 - timestamp_bits), so that the clock wraps at 32 bits, which it
                             can have from 2 on; 0 if windows are of a number of events */
    uint32_t tau;         /* length of a window in microseconds, scaled, 1 to half the clock's
                             period - 1; 1 s suits most routes. 0 if windows are of a number */
    uint32_t budget;      /* selected events of a window, 1 to 2^32 - 1: 3 per pixel suit most
                             routes. 0 if windows are of a fixed time */
    uint32_t place_count; /* 1 to 65535 */
    uint32_t length;      /* windows of a sequence, 1 to place_count: 5 suits most routes. Of the
                             filter 1 */
    uint32_t exclusion;   /* places on each side of the best in which no second best is looked for,
                             0 to 65535: as many as lie within the tolerance of a correct match */
    uint32_t largest_sum; /* largest accepted sum of a sequence, 0 to 2^32 - 1: 2^32 - 1 accepts all;
                             choose it on a drive with ground truth */
    uint32_t code_max;    /* 1, 3, 7 ... 255: 7 (3 bits) suits contrast codes */
    uint32_t steps;       /* of 0, 1 ... places that have a cost, of the filter: 5, or 7 with two
                             places per window. 0: sequences */
    uint32_t gains;       /* of the camera, of the filter: 1 or 7 */
    uint32_t sums;        /* of newest windows that have codes: 1, or 3 with seven gains */
    uint32_t lane_shift;  /* 2^lane_shift bytes of metrics a place */
    uint32_t restart; /* cost of jumping to any place (kidnapped robot), in 1/4, 0 to 120: 64 suits
                         most routes, 0 matches every window alone */
    uint32_t trust;   /* least accepted trust of the filter, 0 to 368: 0 accepts every match with a
                         second best; choose it on a drive with ground truth */
    uint32_t activity; /* mean events that count of a window of the reference drive, in 1/256, 0 to
                          2^31 - 257. 0: no window is a pause before events arrive */
    bool contrast;     /* contrast codes: logarithms less the means of their counters and of their
                          window, for light and speed that differ; else counts */
    uint32_t checksum; /* of the image */
} vpr_design_t;

/* State, written by the functions below alone; its arrays lie in the block of RAM. */
typedef struct {
    uint16_t *counts;     /* [slots]: 0 to count_max */
    uint16_t *before;     /* [3][slots], of seven gains: counts of the last three windows, newest first */
    uint8_t *query;       /* [sums][stride]: codes of the window that ended last, or of sums with it */
    uint16_t *history;    /* [length][place_count]: distances of the last windows, a ring */
    uint32_t *delay;      /* [exclusion + 1]: sums still within the exclusion zone, a ring */
    uint32_t window_end;  /* of the open window, scaled */
    uint32_t left;        /* events at selected pixels that the open window still takes */
    uint32_t windows;     /* that have ended, modulo 2^32 */
    uint32_t seen;        /* the same, at most length */
    uint32_t newest;      /* row of history, 0 to length - 1 */
    uint32_t mean_activity; /* events that count of a window, in 1/256, 0 to 2^31 - 257 */
    int32_t activity;     /* of the window that ended last, against that or, with seven gains, against
                             the design's: 1/16 octave, -368 to 368 */
    bool paused;          /* that window had hardly any events */
    uint32_t *mean;       /* [sums][slots], of contrast codes: running mean of the logarithm, in 1/65536
                             octave, 0 to 2560 * 256 */
    uint32_t mean_shift;  /* a running mean moves by 1/2^mean_shift of the difference, 4 to 8 */
    uint32_t mean_windows; /* windows that moved them, plus 16, until mean_shift is 8 */
    uint8_t *metric;      /* [place_count], of the filter: 0 to 127. Of seven gains [place_count][8] */
    uint32_t *bank;       /* the same as words: [place_count][2] */
    uint16_t *distance;   /* [place_count], of the filter: of the last sum that was compared */
    uint32_t reciprocal[3]; /* of each sum, of the spread of the window before, in 1/65536, 1 to 65536;
                               0: it has none */
    uint32_t least;       /* metric, 0 to 127 */
    uint32_t place;       /* best place of the window before, or VPR_NONE */
    uint32_t gain;        /* of its metric, half octaves from -32/16 on, 0 to 6 */
    uint32_t few;         /* windows with few events in a row, 0 to 3: the robot stands */
    uint32_t speed;       /* mean activity of the drive plus 368, in 1/256 octave, 0 to 11776 */
    uint32_t moved;       /* windows that moved it, 0 to 63 */
    uint32_t support;     /* of the match before, 0 to 368 */
    uint32_t age;         /* windows in which the best place followed, 0 to 8 */
    uint32_t residual;    /* evidence against that match, 0 to 255; from 23 on, no trust is left */
    uint32_t residual_before; /* evidence against the match before that one, 0 to 255 */
    uint32_t checksum;    /* of the image of the design that it belongs to */
} vpr_state_t;

typedef enum {
    VPR_ALL_TAKEN = 0,
    VPR_WINDOW_ENDS = 1 /* before the event at `next`, if there is one */
} vpr_status_t;

typedef struct {
    uint32_t window;     /* number of the window that ended last, from 0 */
    uint32_t place;      /* best place, 0 to place_count - 1; of a sequence where it ends; of the filter
                            the middle of the places near the best */
    uint32_t sum;        /* distance of the whole sequence; of the filter the metric, 0 to 127 */
    uint32_t second;     /* best place outside the exclusion zone, or VPR_NONE */
    uint32_t second_sum; /* its sum, or VPR_NONE */
    uint32_t ties;       /* further places with the sum of the best */
    bool accepted;       /* by trust or largest_sum of the design: drive by accepted matches alone */
    uint32_t trust;      /* of the filter, 0 to 368: higher means more confident; else 0 */
} vpr_match_t;

/* Check an image and read its design. False: it is none, of another version, damaged, or beyond the
 * limits of this firmware (codes of at most 8 bits, a distance of at most 16, and comparisons of at
 * most 32); on failure `*d` is undefined. `image` is aligned to 16 bytes, and `image_bytes` of it can
 * be read, at least as many as the image has; both are all that is trusted.
 *
 * True: every word of the header and every entry of the tables is within its range. As long as the
 * image stays as it is, no events, whatever their pixels and times, make the functions below read
 * outside the image and the RAM, write outside the RAM, or run for ever; a single event ends at
 * most (half the clock's period) / tau + 1 windows. Every sum is exact. The checksum finds an image that
 * was damaged into another valid one; it does not guard against one that was made so. */
bool vpr_open(vpr_design_t *d, const uint32_t *image, uint32_t image_bytes);

/* Bytes of RAM that the state needs beside vpr_state_t. */
uint32_t vpr_ram_bytes(const vpr_design_t *d);

/* Begin: all counters zero, the first window opens at `start`. `ram` is aligned to 16 bytes. */
void vpr_reset(const vpr_design_t *d, vpr_state_t *s, uint32_t *ram, uint32_t start);

/* Go on from a saved state, as after a deep sleep: `*s` as it was saved, and in `ram`, aligned to 16
 * bytes, the saved vpr_ram_bytes of its block, which may lie elsewhere now. False: it belongs to
 * another image, and nothing is changed. Saved bytes are trusted: put a checksum of your own behind
 * them if their memory may lose some. The clock goes on from where it was, or the times of events are
 * moved by what it lost. */
bool vpr_resume(const vpr_design_t *d, vpr_state_t *s, uint32_t *ram);

/* Slot of the counter that an event belongs to, or VPR_NONE. */
uint32_t vpr_slot(const vpr_design_t *d, const vpr_event_t *e);

/* Take the events from `*next` on, until a window ends or there are no more; `*next` is left at the
 * first one that was not taken. Each takes constant time. */
vpr_status_t vpr_events(const vpr_design_t *d, vpr_state_t *s, const vpr_event_t **next,
                        const vpr_event_t *end);

/* Number of windows that an event at time `t` would end: the caller ends and matches as many. Called
 * once a window while no events come, it is 0 or 1, the clock may wrap during a silence of any length,
 * and the event after it ends no window of the silence. If it was not called for long, there are as
 * many windows to be matched: vpr_reset, which forgets the place, may be the better choice. 0 if
 * windows are of a number of events. */
uint32_t vpr_time(const vpr_design_t *d, const vpr_state_t *s, uint32_t t);

/* End the open window: its codes go to `query`, its counters are cleared, the next one opens. */
void vpr_window_end(const vpr_design_t *d, vpr_state_t *s);

/* Compare the window that ended last with every place. False: fewer than `length` windows so far,
 * and no match; the place filter has always one. To be called once after every vpr_window_end. */
bool vpr_match_places(const vpr_design_t *d, vpr_state_t *s, vpr_match_t *m);

#ifdef __cplusplus
}
#endif

#endif
