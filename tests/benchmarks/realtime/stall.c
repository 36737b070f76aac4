/* A disk that stalls: write(2) and fdatasync(2) on one descriptor wait until a moment that the soak test sets. */
#define _GNU_SOURCE
#include <stdatomic.h>
#include <stdint.h>
#include <sys/types.h>
#include <time.h>
#include <unistd.h>

_Atomic int64_t stall_descriptor = -1, stall_until; /* CLOCK_MONOTONIC, ns */

static void stall(int descriptor)
{
    int64_t until = atomic_load(&stall_until);
    struct timespec t = {.tv_sec = until / 1000000000, .tv_nsec = until % 1000000000};
    if (descriptor == atomic_load(&stall_descriptor) && until != 0)
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) != 0)
            ;
}

ssize_t stalling_write(int descriptor, const void *data, size_t size)
{
    stall(descriptor);
    return write(descriptor, data, size);
}

int stalling_fdatasync(int descriptor)
{
    stall(descriptor);
    return fdatasync(descriptor);
}
