/* What the program still wants of the flash once it runs from RAM. */
#ifndef RP2040_FLASH_H
#define RP2040_FLASH_H

#include <stdint.h>

/* The number that no other flash has, first byte first; all bits equal when this kind of flash has none. From here on the
 * flash cannot be read as memory. */
uint64_t flash_unique_id(void);

#endif
