/* Recognise places on a Cortex-M4: the map lies in flash, events come from the board.
 *
 * map.h is a case.h of golden vectors (docs/firmware.md): a map's image, and recorded events that
 * stand in for a camera here. Replace the part "the board" by your own.
 */
#include "map.h"
#include "vpr.h"

/* ---- results, for a debugger, the motors or a test ---- */

volatile uint32_t matches; /* accepted so far */
volatile uint32_t place;   /* of the newest one */
volatile bool refused;     /* the image is damaged, or needs more RAM than map.h says */

/* ---- the board: recorded events in place of a camera ---- */

static const vpr_event_t *camera_next(const vpr_event_t **end)
{
    const vpr_event_t *const first = (const vpr_event_t *)(const void *)case_events;
    *end = first + (CASE_EVENTS_BYTES / sizeof(vpr_event_t));
    return first;
}

/* ---- the firmware ---- */

static _Alignas(16) uint32_t ram[CASE_RAM_BYTES / sizeof(uint32_t)];
static vpr_design_t design;
static vpr_state_t state;

int main(void)
{
    vpr_match_t match;
    const vpr_event_t *end;
    const vpr_event_t *next = camera_next(&end);
    (void)case_expected; /* only a test reads it */

    if (!vpr_open(&design, case_image, CASE_IMAGE_BYTES) ||
        (vpr_ram_bytes(&design) > CASE_RAM_BYTES)) {
        refused = true;
        return 1;
    }
    vpr_reset(&design, &state, ram, CASE_START);
    while (next != end) {
        if (vpr_events(&design, &state, &next, end) == VPR_WINDOW_ENDS) {
            vpr_window_end(&design, &state);
            if (vpr_match_places(&design, &state, &match) && match.accepted) {
                place = match.place;
                matches = matches + 1U;
            }
        }
    }
    return 0;
}
