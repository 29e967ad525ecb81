/* CRC-32 of Ethernet, half a byte at a time: 64 bytes of table, not 1024. It begins with all ones,
 * and is inverted in the end. */
#ifndef VPR_CRC_H
#define VPR_CRC_H

#include <stdint.h>

static const uint32_t crc_table[16] = {
    0x00000000U, 0x1DB71064U, 0x3B6E20C8U, 0x26D930ACU, 0x76DC4190U, 0x6B6B51F4U,
    0x4DB26158U, 0x5005713CU, 0xEDB88320U, 0xF00F9344U, 0xD6D6A3E8U, 0xCB61B38CU,
    0x9B64C2B0U, 0x86D3D2D4U, 0xA00AE278U, 0xBDBDF21CU};

/* Take the lowest bytes of a word into the checksum; those above are 0. */
static uint32_t crc_after(uint32_t crc, uint32_t word, uint32_t bytes)
{
    crc ^= word;
    for (uint32_t i = 0U; i < bytes; i++) {
        crc = (crc >> 4) ^ crc_table[crc & 15U];
        crc = (crc >> 4) ^ crc_table[crc & 15U];
    }
    return crc;
}

#endif
