/* The files of semihosting.h by this computer's own C library, so that the same program runs here. */
#include "semihosting.h"

#include <stdio.h>
#include <stdlib.h>

static FILE *files[2];
static int32_t count;

static int32_t open(const char *name, const char *mode)
{
    files[count] = fopen(name, mode);
    return files[count] == NULL ? -1 : count++;
}

int32_t semihosting_open_to_read(const char *name)
{
    return open(name, "rb");
}

int32_t semihosting_open_to_write(const char *name)
{
    return open(name, "wb");
}

bool semihosting_read(int32_t file, uint8_t *into, size_t bytes)
{
    return fread(into, 1, bytes, files[file]) == bytes;
}

bool semihosting_write(int32_t file, const uint8_t *from, size_t bytes)
{
    return fwrite(from, 1, bytes, files[file]) == bytes && fflush(files[file]) == 0;
}

void semihosting_exit(uint32_t code)
{
    exit((int)code);
}
