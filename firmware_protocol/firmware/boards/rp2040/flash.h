/* The flash's serial number, read once the program runs from RAM. */
#ifndef RP2040_FLASH_H
#define RP2040_FLASH_H

#include <stdint.h>

/* Return the unique number of the flash, first byte first; all bits are equal if this type of flash has no number.
 * Afterwards the flash cannot be read as memory. */
uint64_t flash_unique_id(void);

#endif
