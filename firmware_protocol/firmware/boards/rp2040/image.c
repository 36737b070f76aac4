#include "image.h"

#include "start.h"

/* CRC-32/ISO-HDLC, a nibble at a time: a table of the core's is in the RAM that is being checked. */
static const uint32_t table[16] __attribute__((section(".start_table"))) = {
    0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
    0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C,
};

AT_START static uint32_t crc_over(uint32_t crc, const uint8_t *begins, const uint8_t *ends)
{
    for (; begins != ends; begins++) {
        crc ^= *begins;
        crc = crc >> 4 ^ table[crc & 15u];
        crc = crc >> 4 ^ table[crc & 15u];
    }
    return crc;
}

AT_START bool image_is_whole(void)
{
    const uint32_t start = crc_over(UINT32_MAX, start_begins, ram_image);
    return ~crc_over(start, ram_begins, ram_ends) == image_crc;
}
