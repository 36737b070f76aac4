/* The yardstick of test_round_trips.py, as a careful programmer writes the loop for one link, one estimator and one law:
   client DESCRIPTOR PRIORITY SECONDS SESSION PAUSE_NS

   For each STATE: ppoll for PAUSE_NS at most, as the loop waits, read, check and decode; finite difference and Butterworth filter; a wall; COMMAND, write; a row
   with its time stamps. Writes the receipt time of each row (int64, ns) to standard output when it is done. */
#define _GNU_SOURCE
#include <errno.h>
#include <stdlib.h>
#include <sys/mman.h>
#include "frames.h"

struct row {
    int64_t tick, sample, device_time, received, computed, sent, count, edge_age, current_applied, current_measured;
    int64_t command_age, limits, fault, state, inputs, missed, execution, current_sent;
    double position, velocity, penetration, effort;
};

struct state {
    int64_t sequence, sample, time, count, edge, measured, applied, limits, fault, execution, missed, state, inputs, age;
};

#define ROWS 100000
static struct row rows[ROWS];

/* The newest STATE of the session in buffer[0..*filled): 1 if there is one; an unfinished frame moves to the front. */
static int newest(uint8_t *buffer, int *filled, int session, struct state *s)
{
    uint8_t raw[ROOM];
    int start = 0, found = 0;
    for (int i = 0; i < *filled; i++)
        if (buffer[i] == 0) {
            int length = unseal(buffer + start, i - start, raw);
            start = i + 1;
            if (length != HEADER + STATE_PAYLOAD || raw[0] != MAJOR || raw[1] != STATE_TYPE || raw[3] != session)
                continue;
            const uint8_t *at = raw + HEADER;
            int64_t sample = get(at + 4, 4);
            if (s->sample >= sample)
                continue;
            s->sample = sample;
            s->sequence = get(raw + 4, 2), s->age = get(at + 2, 2);
            s->time = get(at + 8, 4), s->count = (int32_t)get(at + 12, 4), s->edge = get(at + 16, 4);
            s->measured = (int16_t)get(at + 20, 2), s->applied = (int16_t)get(at + 22, 2);
            s->limits = get(at + 24, 2), s->fault = get(at + 26, 2);
            s->execution = get(at + 28, 2), s->missed = get(at + 30, 2), s->state = at[32], s->inputs = at[33];
            found = 1;
        }
    *filled -= start;
    memmove(buffer, buffer + start, *filled);
    return found;
}

int main(int count, char **arguments)
{
    if (count != 6)
        return 2;
    int descriptor = atoi(arguments[1]), session = atoi(arguments[4]), filled = 0, sequence = 0;
    int64_t length = (int64_t)(atof(arguments[3]) * 1e9), pause = atoll(arguments[5]), tick = 0, before = 0, heard;
    struct state s = {.sample = -1};
    uint8_t buffer[4096], frame[ROOM];
    double s1 = 0.0, s2 = 0.0, velocity = 0.0;
    memset(rows, 1, sizeof rows);
    mlockall(MCL_CURRENT);
    crc_prepare();
    alarm(600);
    if (become_fifo(atoi(arguments[2])) != 0)
        return 3;
    int64_t end = now_ns() + length;
    heard = now_ns();
    while (tick < ROWS) {
        struct pollfd p = {.fd = descriptor, .events = POLLIN};
        struct timespec t = {.tv_nsec = pause};
        int64_t started = now_ns();
        if (started > end)
            break;
        if (ppoll(&p, 1, &t, NULL) < 1) {
            if (started - heard > 2000000000)
                return 4;
            continue;
        }
        if (!(p.revents & POLLIN))
            return 8;
        ssize_t got = read(descriptor, buffer + filled, sizeof buffer - filled);
        if (got <= 0)
            return 5;
        filled += (int)got;
        if (!newest(buffer, &filled, session, &s))
            continue;
        int64_t received = heard = now_ns();
        double slope = (double)(s.count - before) * 1e-6 * 1e4, position = (double)s.count * 1e-6;
        before = s.count;
        velocity = 0.0036 * slope + s1;
        s1 = 0.0072 * slope + 1.82 * velocity + s2;
        s2 = 0.0036 * slope - 0.834 * velocity;
        double penetration = position - 1e-5;
        double effort = penetration > 0.0 ? 500.0 * penetration + 0.5 * velocity : 0.0;
        effort = effort < 0.0 ? 0.0 : effort > 1.0 ? 1.0 : effort;
        int64_t current = (int64_t)(-effort * 100.0), computed = now_ns();
        uint8_t *at = put(put(frame + 1 + HEADER, (uint64_t)s.sequence, 2), 5000, 4);
        put(put(put(at, 0, 1), 0, 1), (uint16_t)current, 2);
        int size = seal(frame, COMMAND_TYPE, session, sequence, COMMAND_PAYLOAD);
        sequence = (sequence + 1) & 0xFFFF;
        if (write(descriptor, frame, size) != size)
            return 6;
        rows[tick] = (struct row){.tick = tick, .sample = s.sample, .device_time = s.time, .received = received,
            .computed = computed, .sent = now_ns(), .count = s.count, .edge_age = s.time - s.edge,
            .current_applied = s.applied, .current_measured = s.measured, .command_age = s.age, .limits = s.limits,
            .fault = s.fault, .state = s.state, .inputs = s.inputs, .missed = s.missed, .execution = s.execution,
            .current_sent = current, .position = position, .velocity = velocity, .penetration = penetration,
            .effort = effort};
        tick++;
    }
    for (int64_t k = 0; k < tick; k++)
        if (fwrite(&rows[k].received, sizeof rows[k].received, 1, stdout) != 1)
            return 7;
    return 0;
}
