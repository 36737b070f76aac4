#include "loop.h"

#include <errno.h>
#include <poll.h>
#include <time.h>
#include <unistd.h>

#define READ_BYTES 4096u
#define READS 16u     /* of one end in a row: of a bus that is full of other frames, too */
#define NS_PER_SECOND 1000000000
#define UNIT_TWICE_NS 125 /* two units of device time */

enum end { HOST, BUS, WAKE, ENDS };

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * NS_PER_SECOND + now.tv_nsec;
}

static uint64_t now_units(void)
{
    return (uint64_t)now_ns() * 2u / UNIT_TWICE_NS;
}

static bool is_broken(ssize_t count)
{
    return count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR);
}

/* Read all available bytes; false when the other end is closed. */
static bool read_end(struct bridge *bridge, int descriptor,
                 void (*receive)(struct bridge *, const uint8_t *, size_t, uint64_t))
{
    uint8_t bytes[READ_BYTES];
    for (unsigned i = 0; i < READS; i++) {
        const ssize_t count = read(descriptor, bytes, sizeof bytes);
        if (count > 0)
            receive(bridge, bytes, (size_t)count, now_units());
        else
            return !is_broken(count);
    }
    return true;
}

/* Write as many waiting bytes as the descriptor accepts; a CAN socket takes one frame a call. False when it is closed. */
static bool write_end(struct bridge *bridge, int descriptor, uint8_t *from, size_t *there, size_t most,
                size_t (*take)(struct bridge *, uint8_t *, size_t))
{
    uint8_t written[SOCKETCAN_BYTES];
    while (*there > 0) {
        const ssize_t count = write(descriptor, from, *there < most ? *there : most);
        if (count <= 0)
            return !is_broken(count);
        for (size_t left = (size_t)count; left > 0;)
            left -= take(bridge, written, left < sizeof written ? left : sizeof written);
    }
    return true;
}

static void write_bus(struct bridge *bridge, int descriptor)
{
    const size_t frame = bridge->kind->classic ? SOCKETCAN_CLASSIC_BYTES : SOCKETCAN_BYTES;
    const size_t most = bridge->setup.socket ? frame : BRIDGE_BUS_BYTES;
    if (!write_end(bridge, descriptor, bridge->bus, &bridge->bus_count, most, bridge_take_bus))
        bridge_lose_bus(bridge, now_units());
}

/* Wait for an end or the next period; descriptors below zero are ignored. */
static void wait_for(struct pollfd *ends, int64_t until_ns)
{
    const int64_t left_ns = until_ns - now_ns();
    const struct timespec left = {
        .tv_sec = left_ns > 0 ? left_ns / NS_PER_SECOND : 0,
        .tv_nsec = left_ns > 0 ? left_ns % NS_PER_SECOND : 0,
    };
    for (unsigned i = 0; i < ENDS; i++)
        ends[i].revents = 0;
    ppoll(ends, ENDS, &left, NULL);
}

void bridge_run(struct bridge *bridge, const struct bridge_ends *ends)
{
    struct pollfd waited[ENDS] = {
        [HOST] = {.fd = ends->host, .events = POLLIN},
        [BUS] = {.fd = ends->bus, .events = POLLIN},
        [WAKE] = {.fd = ends->wake, .events = POLLIN},
    };
    bridge->clock = now_units;
    bridge_start(bridge, now_units());
    bool host_there = false;
    while (waited[WAKE].revents == 0) {
        wait_for(waited, (int64_t)(bridge->due / 2u) * UNIT_TWICE_NS);
        if (waited[HOST].fd >= 0)
            host_there = (waited[HOST].revents & POLLHUP) == 0;
        if (waited[BUS].revents != 0 && !read_end(bridge, ends->bus, bridge_receive_bus))
            bridge_lose_bus(bridge, now_units());
        if (waited[HOST].revents != 0 && !read_end(bridge, ends->host, bridge_receive_host)) {
            if (!ends->host_stays)
                break;
            bridge->output_count = 0; /* the next host begins with an empty line */
            waited[HOST].fd = -1;     /* a terminal without a host is always ready: check it once a period */
        }
        bridge_poll(bridge, now_units());
        if (now_units() >= bridge->due) {
            bridge_tick(bridge, now_units());
            write_bus(bridge, ends->bus);
            waited[HOST].fd = ends->host;
        }
        write_bus(bridge, ends->bus);
        if (bridge->bus_lost)
            waited[BUS].fd = -1;
        if (host_there)
            write_end(bridge, ends->host, bridge->output, &bridge->output_count, BRIDGE_OUTPUT_BYTES, bridge_take);
    }
    bridge_stop(bridge);
    write_bus(bridge, ends->bus);
}
