#include "flash.h"

#include "registers.h"

/* Read Unique ID of Winbond's data sheets (W25Q16JV, 8.2.30), which other makers use too: the command, four dummy bytes,
 * the number. All of it fits the controller's queue of 16, which starts when the flash is selected. */
#define READ_UNIQUE_ID 0x4Bu
#define SILENT_BYTES 5u
#define ID_BYTES 8u

uint64_t flash_unique_id(void)
{
    uint64_t id = 0;
    SSI_ENABLE = 0;
    SSI_CONTROL = SSI_BYTES_BOTH_WAYS;
    SSI_SELECT = 0;
    SSI_ENABLE = 1;
    SSI_DATA = READ_UNIQUE_ID;
    for (uint32_t i = 1; i < SILENT_BYTES + ID_BYTES; i++)
        SSI_DATA = 0;
    SSI_SELECT = 1;
    while (SSI_RECEIVED < SILENT_BYTES + ID_BYTES)
        continue;
    for (uint32_t i = 0; i < SILENT_BYTES + ID_BYTES; i++)
        id = id << 8 | (SSI_DATA & 0xFFu); /* the dummy bytes are shifted out */
    SSI_ENABLE = 0;
    return id;
}
