#include "semihosting.h"

#include <string.h>

enum operation { OPEN = 0x01, WRITE = 0x05, READ = 0x06, EXIT_EXTENDED = 0x20 };
enum mode { READ_BINARY = 1, WRITE_BINARY = 5 };
#define APPLICATION_EXIT 0x20026u

static int32_t call(enum operation operation, const void *argument)
{
    register int32_t result __asm__("r0") = (int32_t)operation;
    register const void *block __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(result) : "r"(block) : "memory");
    return result;
}

static int32_t open(const char *name, enum mode mode)
{
    const struct {
        const char *name;
        uint32_t mode, length;
    } block = {name, mode, (uint32_t)strlen(name)};
    return call(OPEN, &block);
}

int32_t semihosting_open_to_read(const char *name)
{
    return open(name, READ_BINARY);
}

int32_t semihosting_open_to_write(const char *name)
{
    return open(name, WRITE_BINARY);
}

bool semihosting_read(int32_t file, uint8_t *into, size_t count)
{
    while (count > 0) {
        const struct {
            int32_t file;
            uint8_t *into;
            uint32_t count;
        } block = {file, into, (uint32_t)count};
        const int32_t missing = call(READ, &block);
        if (missing < 0 || (size_t)missing >= count)
            return false;
        into += count - (size_t)missing;
        count = (size_t)missing;
    }
    return true;
}

bool semihosting_write(int32_t file, const uint8_t *bytes, size_t count)
{
    const struct {
        int32_t file;
        const uint8_t *bytes;
        uint32_t count;
    } block = {file, bytes, (uint32_t)count};
    return call(WRITE, &block) == 0;
}

void semihosting_exit(uint32_t code)
{
    const uint32_t block[2] = {APPLICATION_EXIT, code};
    call(EXIT_EXTENDED, block);
    for (;;)
        continue;
}
