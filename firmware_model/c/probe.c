/* Not part of the firmware: what firmware_model.emulation.instructions asks for besides. */
#include "sad.h"
#include "vpr.h"

uint32_t probe_sad(const uint8_t *a, const uint8_t *b, uint32_t bytes);
uint32_t probe_struct_bytes(void);

uint32_t probe_sad(const uint8_t *a, const uint8_t *b, uint32_t bytes)
{
    return sad(a, b, bytes);
}

uint32_t probe_struct_bytes(void)
{
    return (uint32_t)(sizeof(vpr_design_t) + sizeof(vpr_state_t));
}
