/* A drive that costs nothing, behind an adapter: drive_end DESCRIPTOR
   Each line that asks for a reply gets OK, and a reply of a moteus to its sender; ends when its line does. */
#define _GNU_SOURCE
#include <poll.h>
#include <string.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

int main(int argc, char **argv)
{
    const int line = argc > 1 ? atoi(argv[1]) : -1;
    char said[128];
    static char buffer[4096];
    size_t filled = 0;
    for (;;) {
        struct pollfd ready = {.fd = line, .events = POLLIN};
        poll(&ready, 1, -1);
        const ssize_t count = read(line, buffer + filled, sizeof buffer - filled);
        if (count <= 0)
            return 0;
        filled += (size_t)count;
        char *end;
        while ((end = memchr(buffer, '\n', filled)) != NULL) { /* can send 9101 … */
            const size_t length = (size_t)(end - buffer) + 1;
            if (length > 13 && buffer[9] >= '8') {
                const int bytes = snprintf(said, sizeof said,
                                           "OK\r\nrcv 01%c%c 2100002F01000000000000000000000000230D301900 E B F\r\n",
                                           buffer[9] - 8, buffer[10]);
                if (write(line, said, (size_t)bytes) != bytes)
                    return 1;
            }
            memmove(buffer, end + 1, filled - length);
            filled -= length;
        }
    }
}
