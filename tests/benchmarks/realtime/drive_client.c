/* The yardstick of test_bridge.py: one query a period to a drive, as a careful programmer writes it:
   drive_client DESCRIPTOR RATE TICKS LINE
   Writes the round trip of each tick (int64, ns; -1 for none) to standard output when it is done. */
#define _GNU_SOURCE
#include <poll.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define MOST 100000
static int64_t took[MOST];

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

int main(int argc, char **argv)
{
    if (argc < 5)
        return 2;
    const int line = atoi(argv[1]), ticks = atoi(argv[3]) < MOST ? atoi(argv[3]) : MOST;
    const int64_t period = 1000000000 / atoi(argv[2]);
    static char text[512], heard[4096];
    const size_t length = strlen(argv[4]);
    memcpy(text, argv[4], length);
    text[length] = '\n';
    int64_t due = now_ns() + period;
    for (int tick = 0; tick < ticks; tick++) {
        const struct timespec until = {due / 1000000000, due % 1000000000};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
        const int64_t begun = now_ns();
        if (write(line, text, length + 1) != (ssize_t)length + 1)
            return 1;
        size_t filled = 0;
        took[tick] = -1;
        while (took[tick] < 0 && filled < sizeof heard - 1) {
            struct pollfd ready = {.fd = line, .events = POLLIN};
            if (poll(&ready, 1, 100) <= 0)
                break;
            const ssize_t count = read(line, heard + filled, sizeof heard - 1 - filled);
            if (count <= 0)
                return 1;
            filled += (size_t)count;
            heard[filled] = 0;
            const char *reply = strstr(heard, "rcv ");
            if (reply != NULL && strchr(reply, '\n') != NULL)
                took[tick] = now_ns() - begun;
        }
        due += period;
        while (due < now_ns())
            due += period;
    }
    return write(STDOUT_FILENO, took, (size_t)ticks * sizeof took[0]) < 0;
}
