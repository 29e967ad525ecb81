/* Feed a stimulus to the firmware and write down what it does: the form in which a device returns
 * its results to `edge-vpr golden verify`. */
#ifndef VPR_REPLAY_H
#define VPR_REPLAY_H

#include "vpr.h"

/* A record is its kind, the number of values, and the values, each a 32-bit word:
 *   event:  number, slot (VPR_NONE: not selected), count after it
 *   window: number, events before its end, the code of each slot
 *   match:  window, place, sum, second, second_sum, ties, accepted; of the place filter also trust */
enum { VPR_RECORD_EVENT = 1, VPR_RECORD_WINDOW = 2, VPR_RECORD_MATCH = 3 };

/* Hand the events over `batch` at a time, at least 1; records of events are only written where it is
 * 1. Where `batch` has its second bit, vpr_time ends windows before it is handed over. All memory is
 * filled with a pattern first, so that what is read must have been written; the RAM with zeros where
 * `batch` has its second bit. With twice the RAM that the state needs, it is saved after each window,
 * lost, and goes on in the other half. Words written to `out`; 0 if the image is refused, RAM or
 * `out` are too small, or a function of vpr.h contradicts another. */
uint32_t vpr_replay(const uint32_t *image, uint32_t image_bytes, const vpr_event_t *events,
                    uint32_t event_count, uint32_t batch, uint32_t start, uint32_t *ram,
                    uint32_t ram_bytes, uint32_t *out, uint32_t out_words);

/* Bytes to and from a host, in order. `get` waits for the next one, which comes only while it is
 * called, so that a line needs no buffer. */
typedef struct {
    uint8_t (*get)(void);
    void (*put)(uint8_t byte);
} vpr_line_t;

#define VPR_LINE_MAGIC 0x43525056U /* "VPRC": a case begins */

/* Records on the line besides:
 *   case:    its number
 *   ready:   bytes that are taken next; 0: the case is over
 *   refused: bytes of memory that the case needs; 0: the image is refused */
enum { VPR_RECORD_CASE = 0, VPR_RECORD_READY = 4, VPR_RECORD_REFUSED = 5 };

/* Wait for a case from `edge-vpr golden verify --port`, run it and send its records. The host sends
 * VPR_LINE_MAGIC, the case's number, its start, the bytes of its image and the number of its events,
 * each a 32-bit word, little-endian; then the image and the events (image.bin, events.bin), as far as
 * the records say ready. The device sends the record of the case first. `memory` takes image and
 * state, and is aligned to 16 bytes. */
void vpr_replay_line(const vpr_line_t *line, uint32_t *memory, uint32_t memory_bytes);

#endif
