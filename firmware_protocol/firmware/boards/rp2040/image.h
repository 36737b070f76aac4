/* Check that the program in RAM is the one that was built. */
#ifndef RP2040_IMAGE_H
#define RP2040_IMAGE_H

#include <stdbool.h>
#include <stdint.h>

/* Addresses from the linker script: start code in flash, program copied to RAM, and after both the CRC-32 that the
 * build has stored. */
extern const uint8_t start_begins[], ram_image[], ram_begins[], ram_ends[];
extern const uint32_t image_crc;

/* Return true if the CRC fits. Call once, before any code in RAM runs. */
bool image_is_whole(void);

#endif
