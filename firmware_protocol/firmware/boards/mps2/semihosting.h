/* Services of a debugger, here the emulator, for a program: files, and an exit code. Source: Arm, Semihosting for
 * AArch32 and AArch64 (version 3.0), chapter 7. */
#ifndef HR_SEMIHOSTING_H
#define HR_SEMIHOSTING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Open a file in the directory in which the emulator runs. Returns its handle, negative if it cannot be opened. */
int32_t semihosting_open_to_read(const char *name);
int32_t semihosting_open_to_write(const char *name);

/* Read exactly `count` bytes, waiting for them; false at the end of the file. Time stands still meanwhile. */
bool semihosting_read(int32_t file, uint8_t *into, size_t count);

/* Write all bytes, or return false. */
bool semihosting_write(int32_t file, const uint8_t *bytes, size_t count);

/* End the emulator with this exit code. */
void semihosting_exit(uint32_t code);

#endif
