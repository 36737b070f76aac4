/* Check that the program in RAM is the one that was built. */
#ifndef RP2040_IMAGE_H
#define RP2040_IMAGE_H

#include <stdbool.h>
#include <stdint.h>

/* Of the linker script: the start in flash, up to what is copied; the copy; and behind all of it what the build has put
 * there, the CRC-32 of both. */
extern const uint8_t start_begins[], ram_image[], ram_begins[], ram_ends[];
extern const uint32_t image_crc;

/* Return true if the CRC fits. Call once, before any code in RAM runs. */
bool image_is_whole(void);

#endif
