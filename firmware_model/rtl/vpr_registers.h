/* Registers of vpr_axi_lite, as vpr_registers.sv has them. */
#ifndef VPR_REGISTERS_H
#define VPR_REGISTERS_H

#define VPR_ID 0x00U /* read: 0x56505231 */
#define VPR_DESIGN 0x04U /* read: CRC-32 of the design's file: whether a map is for it */
#define VPR_CONTROL 0x08U /* write: bit 0: restart at the start below; places are kept */
#define VPR_STATUS 0x0cU /* read: bit 0 `PLACE` can be written, bit 1 `EVENT_PIXEL` can be, bit 2 there is a match */
#define VPR_START 0x10U /* read, write: time at which the first window opens */
#define VPR_START_HIGH 0x14U /* read, write: its upper bits, of clocks above 32 bits */
#define VPR_ACTIVITY 0x18U /* read, write: mean number of events in a window, times 256 */
#define VPR_EVENT_TIME 0x20U /* write: time of the next event */
#define VPR_EVENT_TIME_HIGH 0x24U /* write: its upper bits, of clocks above 32 bits */
#define VPR_EVENT_PIXEL 0x28U /* write: column (16 bits), row (15), ON (1); sends the event */
#define VPR_PLACE 0x30U /* write: next 32 bits of a word of `places.mem`, the lowest first */
#define VPR_TABLE_ADDRESS 0x34U /* write: bits 24 to 26 the table (0 displacement, 1 lookup, 2 levels, 3 means, 4 place_activity, 5 limits, 6 place_bias), bits 0 to 19 the word */
#define VPR_TABLE_WORD 0x38U /* write: word of that table; the address then moves by one */
#define VPR_MATCH_WINDOW 0x40U /* read: number of the window */
#define VPR_MATCH_PLACE 0x44U /* read: best place */
#define VPR_MATCH_SUM 0x48U /* read: its sum, or metric */
#define VPR_MATCH_SECOND 0x4cU /* read: second best place; 0xFFFFFFFF if there is none */
#define VPR_MATCH_SECOND_SUM 0x50U /* read: its sum; 0xFFFFFFFF if there is none */
#define VPR_MATCH_TIES 0x54U /* read: other places with the best's sum */
#define VPR_MATCH_ACCEPTED 0x58U /* read: 1 if it is accepted */
#define VPR_MATCH_TRUST 0x5cU /* read: trust of the place filter; 0 of sequences */
#define VPR_MATCH_TAKE 0x60U /* write: any value: the match was read, and the next may come */

#define VPR_ID_VALUE 0x56505231U
/* writes to PLACE for a word of places.mem, by lanes and code bits of design.toml */
#define VPR_PLACE_PARTS(lanes, code_bits) (((lanes) * (code_bits) + 31U) / 32U)

#endif
