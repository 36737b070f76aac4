/* Code that runs from the flash, before the program is in RAM: it may call nothing that is there, constants included. */
#ifndef RP2040_START_H
#define RP2040_START_H

#define AT_START __attribute__((section(".start"), noinline))

#endif
