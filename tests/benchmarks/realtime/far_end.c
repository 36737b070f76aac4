/* The far end of the benchmarks: far_end DESCRIPTOR PRIORITY RATE

   RATE below 0: each good COMMAND is answered by one STATE at once, whose clock counts samples at that rate. Else, from
   the first COMMAND on, STATE goes out RATE times a second, from a thread of its own (reading from a terminal waits for
   a kernel thread of ordinary priority), and COMMANDs are only checked. SCHED_FIFO when PRIORITY is above 0. Ends at the
   hang-up of the line or at SIGTERM, and then prints the good and bad frames, the COMMANDs that were not STOP, the
   STATEs sent, the samples that passed because it woke late, and the STATEs that the line did not take. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include "frames.h"

static volatile sig_atomic_t ended;

static void end(int number)
{
    (void)number;
    ended = 1;
}

struct device {
    int descriptor, priority, sequence, answers;
    _Atomic int session, command_sequence, current; /* of the newest COMMAND */
    uint32_t sample;
    _Atomic int64_t good;
    int64_t started, period, bad, active, untaken, passed;
};

static void send_state(struct device *d)
{
    uint8_t frame[ROOM], *at = frame + 1 + HEADER;
    uint32_t units = (uint32_t)((d->answers ? d->sample * d->period : now_ns() - d->started) * 2 / 125);
    int32_t count = (int32_t)(d->sample / 64 % 512) - 256; /* a handle that moves, outside the wall and inside */
    d->sample++;
    at = put(put(put(put(at, d->command_sequence, 2), NO_AGE, 2), d->sample, 4), units, 4);
    at = put(put(put(put(at, (uint32_t)count, 4), units, 4), (uint16_t)d->current, 2), (uint16_t)d->current, 2);
    at = put(put(put(put(put(put(at, 0, 2), 0, 2), 0, 2), 0, 2), STATE_RUNNING, 1), 0, 1);
    put(put(at, 0, 1), 0, 4); /* no law, no sync */
    int size = seal(frame, STATE_TYPE, d->session, d->sequence, STATE_PAYLOAD);
    d->sequence = (d->sequence + 1) & 0xFFFF;
    if (write(d->descriptor, frame, size) != size)
        d->untaken++;
}

static void take(struct device *d, const uint8_t *frame, int size)
{
    uint8_t raw[ROOM];
    int length = unseal(frame, size, raw);
    if (length != HEADER + COMMAND_PAYLOAD || raw[0] != MAJOR || raw[1] != COMMAND_TYPE) {
        d->bad++;
        return;
    }
    d->good++;
    d->active += raw[HEADER + 6] != MODE_STOP;
    d->session = raw[3];
    d->command_sequence = (int)get(raw + 4, 2);
    d->current = (int16_t)get(raw + HEADER + 8, 2);
    if (d->answers)
        send_state(d);
}

static void *tick(void *argument)
{
    struct device *d = argument;
    while (!ended && d->good == 0)
        usleep(1000);
    int64_t next = now_ns();
    become_fifo(d->priority);
    while (!ended) {
        next += d->period;
        struct timespec t = {.tv_sec = next / 1000000000, .tv_nsec = next % 1000000000};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
        int64_t passed = (now_ns() - next) / d->period; /* samples of which nobody is told */
        d->sample += (uint32_t)passed;
        d->passed += passed;
        next += passed * d->period;
        send_state(d);
    }
    return NULL;
}

int main(int count, char **arguments)
{
    if (count != 4)
        return 2;
    struct device d = {.descriptor = atoi(arguments[1]), .priority = atoi(arguments[2]), .session = 1};
    int64_t rate = atoll(arguments[3]);
    d.answers = rate < 0;
    d.period = 1000000000 / (rate < 0 ? -rate : rate);
    d.started = now_ns();
    pthread_t ticking;
    uint8_t buffer[4096];
    int filled = 0;
    struct sigaction action = {.sa_handler = end};
    sigaction(SIGTERM, &action, NULL);
    signal(SIGINT, SIG_IGN);
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    alarm(3600);
    fcntl(d.descriptor, F_SETFL, fcntl(d.descriptor, F_GETFL) | O_NONBLOCK); /* a tick never waits for a reader */
    crc_prepare();
    if (become_fifo(d.priority) != 0 || (!d.answers && pthread_create(&ticking, NULL, tick, &d) != 0))
        return 3;
    puts("ready");
    fflush(stdout);
    while (!ended) {
        struct pollfd p = {.fd = d.descriptor, .events = POLLIN};
        struct timespec t = {.tv_nsec = 100000000};
        int ready = ppoll(&p, 1, &t, NULL);
        if (ready > 0) {
            ssize_t got = p.revents & POLLIN ? read(d.descriptor, buffer + filled, sizeof buffer - filled) : 0;
            if (got < 0 && (errno == EINTR || errno == EAGAIN || errno == ECONNREFUSED))
                continue;
            if (got <= 0)
                break;
            filled += (int)got;
            int start = 0;
            for (int i = filled - (int)got; i < filled; i++)
                if (buffer[i] == 0) {
                    if (i > start)
                        take(&d, buffer + start, i - start);
                    start = i + 1;
                }
            filled -= start;
            memmove(buffer, buffer + start, filled);
            if (filled == sizeof buffer)
                filled = 0;
        }
    }
    ended = 1;
    if (!d.answers)
        pthread_join(ticking, NULL);
    printf("{\"good\": %lld, \"bad\": %lld, \"active\": %lld, \"states\": %lld, \"passed\": %lld, \"untaken\": %lld}\n",
        (long long)d.good, (long long)d.bad, (long long)d.active, (long long)(d.sample - d.passed), (long long)d.passed,
        (long long)d.untaken);
    return 0;
}
