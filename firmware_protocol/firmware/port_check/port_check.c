/* Check of a port: a program in place of the core that calls `struct hal` itself, one duty after the other.
 *
 * It has the core's entries, so that the port's own files are linked with it unchanged: main, interrupts, start. It judges
 * nothing and sends its observations to the host. Only the probes with a current as argument drive the motor. */
#include "port_check.h"

#include <string.h>

#include "bytes.h"
#include "device.h"
#include "frame.h"
#include "poll.h"

#define UNITS_PER_US HR_TIME_UNITS_PER_US
#define UNITS_PER_MS (UNITS_PER_US * 1000u)
#define UNITS_PER_SECOND (UNITS_PER_US * 1000000u)
#define FEED_US 40000u             /* as the core feeds a device that is not armed */
#define LOOKS 4000000u             /* readings of a clock that stands still, before the wait ends */
#define ARGUMENTS 4u
#define NUMBERS 10u                /* of an answer at most: it is a short frame */
#define AT_NONCE HR_HEADER_BYTES
#define AT_PROBE (AT_NONCE + 2u)
#define AT_NUMBERS (AT_PROBE + 2u)
#define COUNTED_BYTES (AT_NUMBERS + 4u * NUMBERS + HR_CRC_BYTES + 2u) /* on the wire */
#define ROOM_COMES_UNITS (20u * UNITS_PER_MS) /* before an answer to a port that takes what it has no room for */
#define GUARD_BYTES 8u
#define GUARD 0xA5u

typedef bool (*job)(void); /* one step of a long probe; true when the probe is over */

static struct {
    const struct hal *hal;
    const struct board *board;
    struct splitter splitter;
    struct counters counters;
    bool was_reset;
    uint32_t stopped_at;

    uint64_t time, farthest_back; /* last look; largest step back */
    uint32_t rate;
    volatile bool in_poll, in_tick;
    bool held;                                   /* the next tick is to take three periods */
    uint32_t ticks_in_poll, polls_in_tick, ticks_in_tick;
    uint32_t longest_read, overruns, reads;      /* of link_read: without bytes; beyond its capacity */
    uint8_t inputs_ever;

    bool feeds;
    uint32_t last_meal_us; /* the next tick feeds the watchdog with this timeout for the last time; 0: feeding continues */
    uint64_t fed_at;

    uint16_t nonce, probe;
    uint32_t arguments[ARGUMENTS];
    job job;
    uint8_t answer[1u + sizeof(struct packet)]; /* a delimiter ahead: it may follow a piece of a frame */
    size_t answer_bytes;                         /* that wait, until so late */
    uint64_t answers_at;

    struct {
        uint32_t rate, skipped, wanted, count;
        uint64_t first, last, deadline;
        int32_t least, most, newest;
        bool accepted;
    } ticks;
    struct {
        uint32_t tried, taken, refused, longest, sum, room;
        uint64_t full_at;
    } fill;
    uint32_t marks;
} check;

/* ------------------------------------------------------------------ helpers */

static void *context(void)
{
    return check.hal->context;
}

static uint64_t look(void)
{
    const uint64_t now = check.hal->time(context());
    if (now < check.time && check.time - now > check.farthest_back)
        check.farthest_back = check.time - now;
    check.time = now;
    return now;
}

/* Return the time that has passed; 0 if the clock has stepped back. */
static uint64_t since(uint64_t begun)
{
    const uint64_t now = look();
    return now < begun ? 0 : now - begun;
}

static void wait(uint64_t units)
{
    const uint64_t begun = look();
    for (uint32_t i = 0; i < LOOKS && since(begun) < units; i++)
        continue;
}

static uint32_t at_most(uint64_t value)
{
    return value < UINT32_MAX ? (uint32_t)value : UINT32_MAX;
}

static void fill_in(struct packet *packet, uint8_t type, uint16_t nonce, const uint32_t *numbers, size_t count)
{
    uint8_t *raw = packet->bytes + HR_RAW_AT;
    memset(raw, 0, AT_NUMBERS);
    raw[HR_AT_HEADER_MAJOR] = HR_MAJOR;
    raw[HR_AT_HEADER_TYPE_ID] = type;
    put_u16(raw + AT_NONCE, nonce);
    put_u16(raw + AT_PROBE, check.probe);
    for (size_t i = 0; i < count; i++)
        put_u32(raw + AT_NUMBERS + 4u * i, numbers[i]);
    packet->count = AT_NUMBERS + 4u * count;
}

/* Send the reply as soon as the port accepts it. Returns true: the probe is over. */
static bool answer(const uint32_t *numbers, size_t count)
{
    struct packet packet;
    fill_in(&packet, PORT_CHECK_ANSWER, check.nonce, numbers, count);
    const size_t bytes = frame_finish(&packet);
    check.answer[0] = 0;
    memcpy(check.answer + 1, packet.bytes, bytes);
    check.answer_bytes = 1u + bytes;
    check.answers_at = check.time;
    return true;
}
#define ANSWER(...) answer((const uint32_t[]){__VA_ARGS__}, sizeof((const uint32_t[]){__VA_ARGS__}) / 4u)

/* Send a frame of COUNTED_BYTES that contains a number. */
static bool send_counted(uint32_t number, uint32_t *longest)
{
    struct packet packet;
    const uint32_t numbers[] = {number, ~number, number, ~number, number, ~number, number, ~number, number, ~number};
    fill_in(&packet, PORT_CHECK_COUNTED, 0, numbers, NUMBERS);
    const size_t count = frame_finish(&packet);
    const uint64_t begun = look();
    const bool taken = check.hal->link_write(context(), packet.bytes, count);
    const uint32_t took = at_most(since(begun));
    if (took > *longest)
        *longest = took;
    return taken;
}

/* ------------------------------------------------------------------ what the port is */

static uint32_t rate_maximum(void)
{
    for (size_t i = 0; i < check.board->narrower_count; i++)
        if (check.board->narrower[i].parameter == HR_PARAMETER_POSITION_RATE)
            return check.board->narrower[i].maximum;
    return hr_parameters[HR_PARAMETER_POSITION_RATE].maximum;
}

static uint32_t law_maximum(void)
{
    for (size_t i = 0; i < check.board->narrower_count; i++)
        if (check.board->narrower[i].parameter == HR_PARAMETER_LAW)
            return check.board->narrower[i].maximum;
    return hr_parameters[HR_PARAMETER_LAW].maximum;
}

/* Return the time until a set current flows: delay and lag (s). */
static double late_s(void)
{
    return check.board->current_sensor.delay_s + check.board->current_sensor.lag_s;
}

static bool report_board(void)
{
    const struct current_sensor *sensor = &check.board->current_sensor;
    const bool senses = sensor->noise >= 0.0;
    return ANSWER(check.board->rate_initial, rate_maximum(), law_maximum(), senses,
                  senses ? (uint32_t)(late_s() * UNITS_PER_SECOND) : 0u,
                  senses ? (uint32_t)(sensor->noise * 1000.0) : 0u, check.hal->enter_bootloader != NULL, check.was_reset,
                  check.stopped_at, check.board->over_current);
}

static bool report_summary(void)
{
    return ANSWER((uint32_t)check.farthest_back, (uint32_t)(check.farthest_back >> 32), check.longest_read, check.overruns,
                  check.inputs_ever);
}

/* ------------------------------------------------------------------ ticks */

static uint64_t period(void)
{
    return UNITS_PER_SECOND / check.rate;
}

static bool set_rate(uint32_t rate)
{
    const bool accepted = check.hal->set_rate(context(), rate);
    if (accepted)
        check.rate = rate;
    return accepted;
}

/* The grid begins with the second tick: the one that was under way when the rate was set may come at any time. */
static void count_tick(uint64_t now)
{
    if (check.ticks.count >= check.ticks.wanted)
        return;
    if (check.ticks.skipped < 2u) {
        check.ticks.skipped++;
        check.ticks.first = check.ticks.last = now;
        return;
    }
    check.ticks.count++;
    check.ticks.last = now;
    const uint64_t due = (uint64_t)check.ticks.count * UNITS_PER_SECOND / check.ticks.rate;
    const int32_t off = (int32_t)(uint32_t)(now - check.ticks.first - due);
    check.ticks.newest = off;
    if (off < check.ticks.least)
        check.ticks.least = off;
    if (off > check.ticks.most)
        check.ticks.most = off;
}

static bool wait_for_ticks(void)
{
    if (check.ticks.count < check.ticks.wanted && look() < check.ticks.deadline)
        return false;
    const uint32_t count = check.ticks.count;
    check.ticks.wanted = 0;
    return ANSWER(check.ticks.accepted, count, at_most(check.ticks.last - check.ticks.first),
                  (uint32_t)check.ticks.least, (uint32_t)check.ticks.most, (uint32_t)check.ticks.newest);
}

/* Three times as long as they should take. */
static bool begin_ticks(void)
{
    const uint32_t rate = check.arguments[0], wanted = check.arguments[1];
    memset(&check.ticks, 0, sizeof check.ticks);
    check.ticks.accepted = rate == 0 || set_rate(rate);
    check.ticks.rate = rate == 0 ? check.rate : rate;
    check.ticks.deadline = look() + 50u * UNITS_PER_MS + 3u * (wanted + 2u) * (UNITS_PER_SECOND / check.ticks.rate);
    check.ticks.wanted = wanted;
    check.job = wait_for_ticks;
    return false;
}

static bool try_rate(void)
{
    const bool accepted = check.hal->set_rate(context(), check.arguments[0]);
    if (accepted)
        check.hal->set_rate(context(), check.rate);
    return ANSWER(accepted);
}

static bool wait_for_held_tick(void)
{
    return !check.held && ANSWER(check.ticks_in_poll, check.polls_in_tick, check.ticks_in_tick);
}

static bool hold(void)
{
    check.ticks_in_poll = check.polls_in_tick = check.ticks_in_tick = 0;
    wait(3u * period());
    check.held = true;
    check.job = wait_for_held_tick;
    return false;
}

/* ------------------------------------------------------------------ amplifier */

static uint32_t magnitude(int32_t quanta)
{
    return (uint32_t)(quanta < 0 ? -quanta : quanta);
}

static int32_t measured(void)
{
    return check.hal->measured_current(context());
}

static uint64_t settling(void)
{
    const double lag = late_s();
    return UNITS_PER_MS + (uint64_t)((lag < 1e-3 ? 8.0 * lag : 8e-3) * UNITS_PER_SECOND);
}

static uint32_t largest_meanwhile(void)
{
    const uint64_t begun = look();
    uint32_t largest = 0;
    for (uint32_t i = 0; i < LOOKS && since(begun) < settling(); i++)
        largest = magnitude(measured()) > largest ? magnitude(measured()) : largest;
    return largest;
}

/* Return how long more than a quarter of the current flows; 10 ms at most. */
static uint32_t until_gone(int16_t quanta)
{
    const uint64_t begun = look();
    for (uint32_t i = 0; i < LOOKS && 4u * magnitude(measured()) > magnitude(quanta); i++)
        if (since(begun) > 10u * UNITS_PER_MS)
            break;
    return at_most(since(begun));
}

static void switch_off(void)
{
    check.hal->set_current(context(), 0);
    check.hal->enable(context(), false);
}

static bool try_off(int16_t quanta)
{
    switch_off();
    wait(settling());
    check.hal->set_current(context(), quanta);
    const uint32_t off = largest_meanwhile();
    const int32_t last = measured();
    check.hal->enable(context(), true);
    const uint32_t started = largest_meanwhile();
    switch_off();
    return ANSWER(off, (uint32_t)last, started);
}

static bool try_on(int16_t quanta)
{
    check.hal->enable(context(), true);
    check.hal->set_current(context(), quanta);
    const int32_t first = measured();
    wait(settling());
    int32_t sum = 0;
    for (unsigned i = 0; i < 16u; i++) {
        sum += measured();
        wait(4u * UNITS_PER_US); /* a converter is to have another one */
    }
    check.hal->set_current(context(), 0);
    const uint32_t flows = until_gone(quanta);
    switch_off();
    return ANSWER((uint32_t)first, (uint32_t)(sum / 16), flows);
}

static bool try_disable(int16_t quanta)
{
    check.hal->enable(context(), true);
    check.hal->set_current(context(), quanta);
    wait(settling());
    check.hal->enable(context(), false);
    const uint32_t flows = until_gone(quanta);
    switch_off();
    return ANSWER(flows);
}

/* ------------------------------------------------------------------ link */

static bool continue_filling(void)
{
    for (unsigned i = 0; i < 16u; i++) {
        const uint32_t number = ++check.fill.tried;
        const bool taken = send_counted(number, &check.fill.longest);
        check.fill.taken += taken;
        check.fill.sum += taken ? number : 0u;
        check.fill.refused += !taken;
        if (!taken) {
            if (check.fill.full_at == 0)
                check.fill.full_at = check.time;
            break;
        }
        check.fill.room += check.fill.full_at == 0;
    }
    const bool tried = check.fill.tried >= check.arguments[0];
    const bool waited = check.fill.full_at != 0 && check.time - check.fill.full_at > 5u * UNITS_PER_MS;
    if (!tried && !waited)
        return false;
    ANSWER(check.fill.taken, check.fill.room * COUNTED_BYTES, check.fill.refused, check.fill.longest, check.fill.sum);
    check.answers_at += ROOM_COMES_UNITS;
    return true;
}

static bool begin_to_fill(void)
{
    memset(&check.fill, 0, sizeof check.fill);
    check.job = continue_filling;
    return false;
}

/* Like take_bytes of poll.c; how long it takes when nothing has come, and whether it keeps within its room. */
static size_t read_some(uint8_t *bytes)
{
    static const size_t capacities[] = {1u, HR_POLL_BYTES_RUNNING, HR_POLL_BYTES};
    const size_t capacity = capacities[check.reads++ % 3u];
    memset(bytes + capacity, GUARD, GUARD_BYTES);
    const uint64_t begun = look();
    const size_t count = check.hal->link_read(context(), bytes, capacity);
    const uint32_t took = at_most(since(begun));
    if (count == 0 && took > check.longest_read)
        check.longest_read = took;
    for (size_t i = 0; i < GUARD_BYTES; i++)
        check.overruns += bytes[capacity + i] != GUARD;
    check.overruns += count > capacity;
    return count < capacity ? count : capacity;
}

/* ------------------------------------------------------------------ wires: sync outputs tick, trial, inside to encoder A, B, sync input */

#define STEPS 64u
#define SETTLE (2u * UNITS_PER_US)

static uint8_t gray(uint32_t step)
{
    static const uint8_t bits[] = {0, HR_SYNC_TICK, HR_SYNC_TICK | HR_SYNC_TRIAL, HR_SYNC_TRIAL};
    return bits[step % 4u];
}

/* Return by how much a time lies outside of an interval. */
static uint32_t outside(uint64_t moment, uint64_t from, uint64_t to)
{
    return moment < from ? at_most(from - moment) : moment > to ? at_most(moment - to) : 0u;
}

static uint32_t later(uint32_t one, uint32_t other)
{
    return one > other ? one : other;
}

/* There and back with a look at each edge, then as fast as it goes; both lines at once; the sync input, up and down. */
static bool try_wires(void)
{
    const struct hal *hal = check.hal;
    uint32_t moved = 0, wrong = 0, edge_off = 0, sync_off = 0;
    hal->sync(context(), 0);
    wait(SETTLE);
    hal->encoder_failed(context());
    const int32_t zero = hal->encoder_count(context());
    int32_t way = 0;
    for (uint32_t i = 1; i <= 2u * STEPS; i++) {
        const uint32_t step = i <= STEPS ? i : 2u * STEPS - i;
        const uint64_t from = look();
        hal->sync(context(), gray(step));
        const uint64_t to = look();
        wait(SETTLE);
        const int32_t count = hal->encoder_count(context()) - zero;
        if (i == 1)
            way = count;
        moved += count != 0;
        wrong += count != way * (int32_t)step || magnitude(way) != 1u;
        edge_off = later(edge_off, outside(hal->edge_time(context()), from, to));
    }
    for (uint32_t i = 1; i <= 4u * STEPS; i++)
        hal->sync(context(), gray(i));
    wait(SETTLE);
    const uint32_t missed = 4u * STEPS - magnitude(hal->encoder_count(context()) - zero);
    const bool alarmed = hal->encoder_failed(context());
    hal->sync(context(), HR_SYNC_TICK | HR_SYNC_TRIAL);
    wait(SETTLE);
    const bool failed = hal->encoder_failed(context()), again = hal->encoder_failed(context());
    hal->sync(context(), 0);
    wait(SETTLE);
    hal->encoder_failed(context());
    const uint64_t before = hal->sync_time(context()), from = look();
    hal->sync(context(), HR_SYNC_INSIDE);
    const uint64_t to = look();
    wait(SETTLE);
    const uint64_t rose = hal->sync_time(context());
    sync_off = outside(rose, from, to);
    const bool high = (hal->inputs(context()) & HR_INPUT_SYNC) != 0;
    hal->sync(context(), 0);
    wait(SETTLE);
    const bool fell = hal->sync_time(context()) != rose;
    return ANSWER(moved, wrong, missed, edge_off, alarmed, failed, again, rose != before || high, sync_off, fell);
}

/* ------------------------------------------------------------------ hardware watchdog */

static bool wait_for_the_bite(void)
{
    if (check.last_meal_us != 0)
        return false; /* no tick has fed it yet */
    const uint64_t hungry = since(check.fed_at);
    uint32_t longest = 0;
    if (hungry >= (uint64_t)check.marks * UNITS_PER_MS)
        send_counted(check.marks++, &longest);
    if (hungry < 4u * (uint64_t)check.arguments[0] * UNITS_PER_US)
        return false;
    check.feeds = true;
    return ANSWER(check.marks);
}

static bool begin_to_starve(void)
{
    check.marks = 1;
    check.last_meal_us = check.arguments[0];
    check.job = wait_for_the_bite;
    return false;
}

static void feed(uint64_t now)
{
    if (!check.feeds)
        return;
    const uint32_t last_us = check.last_meal_us;
    check.hal->feed_watchdog(context(), last_us != 0 ? last_us : FEED_US);
    check.fed_at = now;
    check.feeds = last_us == 0;
    check.last_meal_us = 0;
}

/* ------------------------------------------------------------------ requests */

/* After a refused frame wait for room: a port that accepts part of a frame would fill the line with fragments. */
static void send_answer(void)
{
    if (look() < check.answers_at)
        return;
    if (check.hal->link_write(context(), check.answer, check.answer_bytes))
        check.answer_bytes = 0;
    else
        check.answers_at = check.time + ROOM_COMES_UNITS;
}

static bool leave(void)
{
    if (check.hal->enter_bootloader != NULL)
        check.hal->enter_bootloader(context());
    return true;
}

static bool begin(void)
{
    const int16_t quanta = (int16_t)(int32_t)check.arguments[0];
    switch ((enum port_check_probe)check.probe) {
    case PROBE_BOARD: return report_board();
    case PROBE_TIME: return look(), ANSWER((uint32_t)check.time, (uint32_t)(check.time >> 32));
    case PROBE_TICKS: return begin_ticks();
    case PROBE_RATE: return try_rate();
    case PROBE_HOLD: return hold();
    case PROBE_OFF: return try_off(quanta);
    case PROBE_ON: return try_on(quanta);
    case PROBE_DISABLE: return try_disable(quanta);
    case PROBE_FILL: return begin_to_fill();
    case PROBE_WIRES: return try_wires();
    case PROBE_BITE: return begin_to_starve();
    case PROBE_SUMMARY: return report_summary();
    case PROBE_LEAVE: return leave();
    }
    return true;
}

static void take_question(const uint8_t *raw, size_t count)
{
    if (count < AT_NUMBERS || raw[HR_AT_HEADER_TYPE_ID] != PORT_CHECK_QUESTION)
        return;
    check.nonce = get_u16(raw + AT_NONCE);
    check.probe = get_u16(raw + AT_PROBE);
    for (size_t i = 0; i < ARGUMENTS; i++)
        check.arguments[i] = AT_NUMBERS + 4u * (i + 1u) <= count ? get_u32(raw + AT_NUMBERS + 4u * i) : 0u;
    begin();
}

static size_t take_bytes(void)
{
    uint8_t bytes[HR_POLL_BYTES + GUARD_BYTES];
    const size_t count = read_some(bytes);
    for (size_t i = 0; i < count; i++) {
        const size_t raw = splitter_take(&check.splitter, bytes[i], &check.counters);
        if (raw > 0)
            take_question(splitter_raw(&check.splitter), raw);
    }
    return count;
}

/* ------------------------------------------------------------------ the core's entries */

void device_start(struct device *device, const struct hal *hal, const struct board *board)
{
    memset(&check, 0, sizeof check);
    device->hal = check.hal = hal;
    device->board = check.board = board;
    device->bite_us = FEED_US;
    splitter_reset(&check.splitter);
    switch_off();
    hal->sync(hal->context, 0);
    set_rate(board->rate_initial);
    check.feeds = true;
    look();
}

void device_was_reset(struct device *device, uint32_t stopped_at)
{
    (void)device;
    check.was_reset = true;
    check.stopped_at = stopped_at;
}

void device_fault(struct device *device, uint8_t fault)
{
    (void)device;
    (void)fault;
    switch_off();
}

bool device_is_armed(const struct device *device)
{
    (void)device;
    return false;
}

void device_tick(struct device *device)
{
    device->unpolled++;
    check.ticks_in_poll += check.in_poll;
    check.ticks_in_tick += check.in_tick;
    check.in_tick = true;
    const uint64_t now = look();
    check.inputs_ever |= check.hal->inputs(context());
    feed(now);
    count_tick(now);
    if (check.held) {
        wait(3u * period());
        check.held = false;
    }
    check.in_tick = false;
}

size_t device_poll(struct device *device)
{
    size_t count = 0;
    check.polls_in_tick += check.in_tick;
    check.in_poll = true;
    device->unpolled = 0;
    if (check.answer_bytes > 0)
        send_answer();
    else if (check.job == NULL)
        count = take_bytes();
    else if (check.job())
        check.job = NULL;
    check.in_poll = false;
    return count;
}
