#include "replay.h"

#include <stddef.h>

#define BATCH 32U /* events that are taken from a line at once */

typedef struct {
    uint32_t *words;
    uint32_t size;
    uint32_t used;          /* beyond size once a word did not fit */
    const vpr_line_t *line; /* that the words go to, or NULL */
} writer_t;

/* Nothing may rest on what memory holds before it is written. */
static void spoil(void *memory, uint32_t bytes, uint8_t pattern)
{
    volatile uint8_t *const at = memory;
    for (uint32_t i = 0U; i < bytes; i++) {
        at[i] = pattern;
    }
}

static void copy(void *to, const void *from, uint32_t bytes)
{
    volatile uint8_t *const at = to;
    for (uint32_t i = 0U; i < bytes; i++) {
        at[i] = ((const uint8_t *)from)[i];
    }
}

static void put(writer_t *w, uint32_t word)
{
    if (w->line != NULL) {
        for (uint32_t shift = 0U; shift < 32U; shift += 8U) {
            w->line->put((uint8_t)(word >> shift));
        }
    } else if (w->used < w->size) {
        w->words[w->used] = word;
    } else {
        /* counted alone */
    }
    w->used++;
}

/* A record of one value. */
static void put_one(writer_t *w, uint32_t kind, uint32_t value)
{
    put(w, kind);
    put(w, 1U);
    put(w, value);
}

static void put_event(writer_t *w, const vpr_state_t *s, uint32_t number, uint32_t slot)
{
    put(w, VPR_RECORD_EVENT);
    put(w, 3U);
    put(w, number);
    put(w, slot);
    put(w, (slot == VPR_NONE) ? 0U : s->counts[slot]);
}

static void put_window(writer_t *w, const vpr_design_t *d, const vpr_state_t *s, uint32_t events)
{
    put(w, VPR_RECORD_WINDOW);
    put(w, 2U + d->slots);
    put(w, s->windows - 1U);
    put(w, events);
    for (uint32_t i = 0U; i < d->slots; i++) {
        put(w, s->query[i]);
    }
}

static void put_match(writer_t *w, const vpr_design_t *d, const vpr_match_t *m)
{
    /* of sequences trust is 0 and not written: if it is not 0, the record differs */
    const bool trust = (d->steps != 0U) || (m->trust != 0U);
    put(w, VPR_RECORD_MATCH);
    put(w, trust ? 8U : 7U);
    put(w, m->window);
    put(w, m->place);
    put(w, m->sum);
    put(w, m->second);
    put(w, m->second_sum);
    put(w, m->ties);
    put(w, m->accepted ? 1U : 0U);
    if (trust) {
        put(w, m->trust);
    }
}

/* Two halves of the RAM: the state is in the first one. */
typedef struct {
    uint32_t *half[2];
    uint32_t bytes; /* of a half; 0: there is no second one */
} halves_t;

/* Lose the memory, but what was saved of it. */
static void lose_memory(const vpr_design_t *d, vpr_state_t *s, halves_t *ram)
{
    uint32_t *const from = ram->half[0];
    vpr_state_t saved;
    copy(&saved, s, (uint32_t)sizeof saved);
    ram->half[0] = ram->half[1];
    ram->half[1] = from;
    copy(ram->half[0], from, ram->bytes);
    spoil(from, ram->bytes, 0xA5U);
    copy(s, &saved, (uint32_t)sizeof saved);
    vpr_design_t other;
    copy(&other, d, (uint32_t)sizeof other);
    other.checksum = ~d->checksum;
    /* a state of another image is refused */
    if (vpr_resume(&other, s, ram->half[0]) || !vpr_resume(d, s, ram->half[0])) {
        spoil(s, (uint32_t)sizeof *s, 0xA5U);
    }
}

static void end_window(writer_t *w, const vpr_design_t *d, vpr_state_t *s, uint32_t events,
                       halves_t *ram)
{
    vpr_match_t match;
    /* small numbers and large ones in turn */
    spoil(&match, (uint32_t)sizeof match, ((s->windows & 1U) != 0U) ? 0U : 0xA5U);
    vpr_window_end(d, s);
    put_window(w, d, s, events);
    if (vpr_match_places(d, s, &match)) {
        put_match(w, d, &match);
    }
    if (ram->bytes != 0U) {
        lose_memory(d, s, ram);
    }
}

uint32_t vpr_replay(const uint32_t *image, uint32_t image_bytes, const vpr_event_t *events,
                    uint32_t event_count, uint32_t batch, uint32_t start, uint32_t *ram,
                    uint32_t ram_bytes, uint32_t *out, uint32_t out_words)
{
    vpr_design_t design;
    vpr_state_t state;
    writer_t writer = {out, out_words, 0U, NULL};

    if ((batch == 0U) || !vpr_open(&design, image, image_bytes) ||
        (vpr_ram_bytes(&design) > ram_bytes)) {
        return 0U;
    }
    const uint32_t needed = vpr_ram_bytes(&design);
    halves_t halves = {{ram, &ram[needed / 4U]}, (ram_bytes >= (2U * needed)) ? needed : 0U};
    spoil(&state, (uint32_t)sizeof state, 0xA5U);
    spoil(ram, needed, ((batch & 2U) != 0U) ? 0U : 0xA5U);
    vpr_reset(&design, &state, ram, start);
    const vpr_event_t *next = events;
    const vpr_event_t *const end = &events[event_count];
    while ((next != end) && (writer.used <= out_words)) {
        const uint32_t taken = (uint32_t)(next - events);
        const uint32_t step = ((event_count - taken) < batch) ? (event_count - taken) : batch;
        const vpr_event_t *const last = &next[step];
        uint32_t due = ((batch & 2U) != 0U) ? vpr_time(&design, &state, next->t) : 0U;
        while ((due > 0U) && (writer.used <= out_words)) {
            end_window(&writer, &design, &state, taken, &halves);
            due--;
        }
        const vpr_status_t status = vpr_events(&design, &state, &next, last);
        if ((status == VPR_ALL_TAKEN) && (next != last)) {
            return 0U; /* it says that it has taken what it has not */
        }
        if (((batch & 2U) != 0U) && (status == VPR_WINDOW_ENDS) && (next == &events[taken])) {
            return 0U; /* vpr_time left out a window that was due */
        }
        if ((batch == 1U) && (next != &events[taken])) {
            put_event(&writer, &state, taken, vpr_slot(&design, &events[taken]));
        }
        if (status == VPR_WINDOW_ENDS) {
            end_window(&writer, &design, &state, (uint32_t)(next - events), &halves);
        }
    }
    return (writer.used <= out_words) ? writer.used : 0U;
}

static uint32_t get_word(const vpr_line_t *line)
{
    uint32_t word = 0U;
    for (uint32_t shift = 0U; shift < 32U; shift += 8U) {
        word |= (uint32_t)line->get() << shift;
    }
    return word;
}

/* Ask for what comes next, and wait for it. */
static void take(writer_t *w, uint32_t *to, uint32_t bytes)
{
    put_one(w, VPR_RECORD_READY, bytes);
    for (uint32_t i = 0U; i < (bytes / 4U); i++) {
        to[i] = get_word(w->line);
    }
}

/* Take events from the line, and write what they do. */
static void run_line(writer_t *w, const vpr_design_t *d, vpr_state_t *s, uint32_t event_count)
{
    vpr_event_t events[BATCH];
    halves_t none = {{NULL, NULL}, 0U};
    for (uint32_t number = 0U; number < event_count; number++) {
        const uint32_t at = number % BATCH;
        const uint32_t left = event_count - number;
        if (at == 0U) {
            /* an event is two words */
            take(w, (uint32_t *)(void *)events, 8U * ((left < BATCH) ? left : BATCH));
        }
        const vpr_event_t *next = &events[at];
        while (next == &events[at]) {
            const vpr_status_t status = vpr_events(d, s, &next, &events[at + 1U]);
            const uint32_t taken = number + ((next == &events[at]) ? 0U : 1U);
            if (taken != number) {
                put_event(w, s, number, vpr_slot(d, &events[at]));
            }
            if (status == VPR_WINDOW_ENDS) {
                end_window(w, d, s, taken, &none);
            }
        }
    }
}

void vpr_replay_line(const vpr_line_t *line, uint32_t *memory, uint32_t memory_bytes)
{
    writer_t writer = {NULL, 0U, 0U, line};
    vpr_design_t design;
    vpr_state_t state;
    uint32_t begun = 0U;

    while (begun != VPR_LINE_MAGIC) {
        begun = (begun >> 8) | ((uint32_t)line->get() << 24);
    }
    const uint32_t number = get_word(line);
    const uint32_t start = get_word(line);
    const uint32_t image_bytes = get_word(line);
    const uint32_t event_count = get_word(line);
    put_one(&writer, VPR_RECORD_CASE, number);
    if (image_bytes > memory_bytes) {
        put_one(&writer, VPR_RECORD_REFUSED, image_bytes);
        return;
    }
    take(&writer, memory, image_bytes);
    if (!vpr_open(&design, memory, image_bytes)) {
        put_one(&writer, VPR_RECORD_REFUSED, 0U);
        return;
    }
    /* an image ends at a multiple of 16 bytes */
    const uint32_t ram_bytes = vpr_ram_bytes(&design);
    if (ram_bytes > (memory_bytes - image_bytes)) {
        put_one(&writer, VPR_RECORD_REFUSED, image_bytes + ram_bytes);
        return;
    }
    uint32_t *const ram = &memory[image_bytes / 4U];
    spoil(&state, (uint32_t)sizeof state, 0xA5U);
    spoil(ram, ram_bytes, 0xA5U);
    vpr_reset(&design, &state, ram, start);
    run_line(&writer, &design, &state, event_count);
    put_one(&writer, VPR_RECORD_READY, 0U);
}
