/* What an image says, computed in the plainest way and with every read checked: what fuzz_main.c
 * holds the firmware against. Shares nothing with it but the layout of events and results. Not part
 * of the firmware. */
#ifndef VPR_PLAIN_H
#define VPR_PLAIN_H

#include "vpr.h"

#define PLAIN_WINDOWS 48U /* at most, in one run */

typedef struct {
    const uint8_t *image;
    uint32_t bytes;
    uint32_t *counts;  /* [slots] */
    uint8_t *codes;    /* [PLAIN_WINDOWS][slots] */
    uint64_t end;      /* of the open window, by the image's clock */
    uint32_t counted;  /* in the open window */
    uint32_t windows;  /* ended so far */
    int64_t usual;     /* events of a window, in units of 1/256 */
    int64_t activity;  /* of the window that ended last, against that, in 1/16 octave */
    bool paused;
    int64_t *mean;     /* [slots]: in units of 1/65536 octave */
    uint32_t moved;    /* windows that moved it */
    int64_t *metric;   /* [places] */
    int64_t reciprocal;
    int64_t *evidence; /* [places]: of the window that ended last */
    int64_t place;     /* of the match before, or -1 */
    int64_t support;
    int64_t residuals[3]; /* of the last matches, the newest first */
} plain_t;

/* The memory is the caller's: that of `plain_free`. */
void plain_begin(plain_t *p, const uint8_t *image, uint32_t bytes, uint32_t start);
void plain_free(plain_t *p);

uint32_t plain_word(const plain_t *p, uint32_t word);

/* Whether an event lies behind the open window's end. */
bool plain_is_behind(const plain_t *p, const vpr_event_t *e);

/* Whether the open window is full. */
bool plain_is_full(const plain_t *p);

/* Count an event; its slot, or VPR_NONE. */
uint32_t plain_take(plain_t *p, const vpr_event_t *e);

/* End the open window: the codes of its counters. */
const uint8_t *plain_window_end(plain_t *p);

/* The match of the window that ended last; false if there is none. */
bool plain_match(plain_t *p, vpr_match_t *m);

#endif
