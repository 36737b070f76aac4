/* Ports that are wrong in one thing: the right one with a function replaced. `wrong_DUTY` or `wrong_DUTY__how` breaks that duty
 * and no other. */
#include "simulated_board.h"

#define UNITS_PER_US HR_TIME_UNITS_PER_US
#define UNITS_PER_SECOND (UNITS_PER_US * 1000000u)

static struct simulated_board *board; /* the one that was spoilt last */
static struct hal right;
static uint32_t calls;
static bool inside; /* a function of a port that calls itself by way of the program */

/* Begin to spoil a board. */
static struct hal *of(struct simulated_board *spoilt)
{
    board = spoilt;
    right = spoilt->hal;
    calls = 0;
    inside = false;
    return &spoilt->hal;
}

static void take_time(uint32_t us)
{
    const uint64_t begun = board->host.time;
    while (board->host.time - begun < us * UNITS_PER_US)
        simulated_board_time(right.context);
}

/* ------------------------------------------------------------------ time */

static uint64_t (*distorted)(uint64_t time); /* whatever is dated is dated by the same clock */

static uint64_t distorted_time(void *context)
{
    return distorted(right.time(context));
}

static uint64_t distorted_edge_time(void *context)
{
    return distorted(right.edge_time(context));
}

static uint64_t distorted_sync_time(void *context)
{
    return distorted(right.sync_time(context));
}

static void distort(struct simulated_board *spoilt, uint64_t (*how)(uint64_t time))
{
    struct hal *hal = of(spoilt);
    distorted = how;
    hal->time = distorted_time;
    hal->edge_time = distorted_edge_time;
    hal->sync_time = distorted_sync_time;
}

/* Now and then a counter and its overflow are of two moments. */
static uint64_t stepping_back(void *context)
{
    const uint64_t now = right.time(context);
    return ++calls % 1000u == 0 ? now - 4096u : now;
}

void wrong_time_steps_back(struct simulated_board *spoilt)
{
    of(spoilt)->time = stepping_back;
}

static uint64_t in_32_bits(uint64_t time)
{
    return (uint32_t)time;
}

void wrong_time_width(struct simulated_board *spoilt)
{
    distort(spoilt, in_32_bits);
}

static uint64_t by_another_divider(uint64_t time)
{
    return time * 25u / 16u;
}

void wrong_time_unit(struct simulated_board *spoilt)
{
    distort(spoilt, by_another_divider);
}

static uint64_t by_another_crystal(uint64_t time)
{
    return time + time / 1000u;
}

void wrong_time_of_timer(struct simulated_board *spoilt)
{
    distort(spoilt, by_another_crystal);
}

/* ------------------------------------------------------------------ the timer */

static bool keeping_its_rate(void *context, uint32_t rate)
{
    (void)context;
    return rate <= UNITS_PER_SECOND;
}

void wrong_tick_rate(struct simulated_board *spoilt)
{
    struct hal *hal = of(spoilt);
    spoilt->host.rate = spoilt->host.board.rate_initial;
    hal->set_rate = keeping_its_rate;
}

static bool rounding_to_milliseconds(void *context, uint32_t rate)
{
    return right.set_rate(context, rate > 1000u && rate <= UNITS_PER_SECOND ? 1000u : rate);
}

void wrong_tick_rate__no_finer_than_a_millisecond(struct simulated_board *spoilt)
{
    of(spoilt)->set_rate = rounding_to_milliseconds;
}

/* Something holds every second tick up, by an eighth of a period. */
static uint8_t holding_ticks_up(void *context)
{
    const uint64_t late = UNITS_PER_SECOND / board->host.rate / 8u;
    if (++calls % 2u != 0)
        board->tick_at += late;
    else
        board->tick_at -= late;
    return right.inputs(context);
}

void wrong_tick_grid(struct simulated_board *spoilt)
{
    of(spoilt)->inputs = holding_ticks_up;
}

static bool taking_any_rate(void *context, uint32_t rate)
{
    if (rate <= UNITS_PER_SECOND)
        return right.set_rate(context, rate);
    return true;
}

void wrong_rate_refused(struct simulated_board *spoilt)
{
    of(spoilt)->set_rate = taking_any_rate;
}

static bool refusing_too_late(void *context, uint32_t rate)
{
    if (rate <= UNITS_PER_SECOND)
        return right.set_rate(context, rate);
    right.set_rate(context, 2000u);
    return false;
}

void wrong_rate_kept(struct simulated_board *spoilt)
{
    of(spoilt)->set_rate = refusing_too_late;
}

static uint64_t letting_ticks_in(void *context)
{
    if (!inside) {
        inside = true;
        simulated_board_tick(board);
        inside = false;
    }
    return right.time(context);
}

void wrong_not_nested__ticks_in_a_poll(struct simulated_board *spoilt)
{
    of(spoilt)->time = letting_ticks_in;
}

/* The link's interrupt polls, in a tick too. */
static uint8_t letting_polls_in(void *context)
{
    if (!inside) {
        inside = true;
        simulated_board_poll(board);
        inside = false;
    }
    return right.inputs(context);
}

void wrong_not_nested__polls_in_a_tick(struct simulated_board *spoilt)
{
    of(spoilt)->inputs = letting_polls_in;
}

/* ------------------------------------------------------------------ encoder and sync */

static void showing_nothing(void *context, uint8_t bits)
{
    (void)context;
    (void)bits;
}

void wrong_sync_bits(struct simulated_board *spoilt)
{
    of(spoilt)->sync = showing_nothing;
}

static int32_t of_one_channel(void *context)
{
    return right.encoder_count(context) & ~1;
}

void wrong_encoder_count(struct simulated_board *spoilt)
{
    of(spoilt)->encoder_count = of_one_channel;
}

/* Counted by software, which does not come by between two that are fast. */
static void losing_fast_ones(void *context, uint8_t bits)
{
    calls += board->host.time == board->host.edge_time;
    right.sync(context, bits);
}

static int32_t without_fast_ones(void *context)
{
    return right.encoder_count(context) - (int32_t)calls;
}

void wrong_encoder_count__loses_fast_ones(struct simulated_board *spoilt)
{
    struct hal *hal = of(spoilt);
    hal->sync = losing_fast_ones;
    hal->encoder_count = without_fast_ones;
}

static uint64_t dating_by_the_tick(void *context)
{
    return right.edge_time(context) / 16000u * 16000u;
}

void wrong_edge_time(struct simulated_board *spoilt)
{
    of(spoilt)->edge_time = dating_by_the_tick;
}

static bool never(void *context)
{
    (void)context;
    return false;
}

void wrong_encoder_failed__never(struct simulated_board *spoilt)
{
    of(spoilt)->encoder_failed = never;
}

static bool again_and_again(void *context)
{
    calls += right.encoder_failed(context);
    return calls != 0;
}

void wrong_encoder_failed__again_and_again(struct simulated_board *spoilt)
{
    of(spoilt)->encoder_failed = again_and_again;
}

static uint64_t of_no_edge(void *context)
{
    (void)context;
    return 0;
}

void wrong_sync_time__never(struct simulated_board *spoilt)
{
    of(spoilt)->sync_time = of_no_edge;
}

/* What the sync input has done last, up or down. */
static uint64_t of_any_edge(void *context)
{
    return right.inputs(context) & HR_INPUT_SYNC ? right.sync_time(context) : board->host.time;
}

void wrong_sync_time__of_falling_edges_too(struct simulated_board *spoilt)
{
    of(spoilt)->sync_time = of_any_edge;
}

/* ------------------------------------------------------------------ amplifier */

/* Its line is active from reset on, until it is driven first. */
static void on_from_reset(void *context, bool on)
{
    calls += on;
    right.enable(context, on || calls == 0);
}

void wrong_off_until_enabled(struct simulated_board *spoilt)
{
    of(spoilt)->enable = on_from_reset;
}

static void with_the_old_set_point(void *context, bool on)
{
    const int16_t quanta = board->host.current;
    right.enable(context, on);
    right.set_current(context, quanta);
}

void wrong_starts_from_zero(struct simulated_board *spoilt)
{
    of(spoilt)->enable = with_the_old_set_point;
}

static uint64_t late_zero(void *context)
{
    if (calls != 0 && --calls == 0)
        right.set_current(context, 0);
    return right.time(context);
}

/* The output takes the value at the end of its period, 1.9 ms later: so many looks at the clock. */
static void at_the_next_period(void *context, int16_t quanta)
{
    if (quanta == 0 && board->host.current != 0)
        calls = 3800;
    else
        right.set_current(context, quanta);
}

void wrong_zero_at_once(struct simulated_board *spoilt)
{
    struct hal *hal = of(spoilt);
    hal->set_current = at_the_next_period;
    hal->time = late_zero;
}

static uint64_t late_off(void *context)
{
    if (calls != 0 && --calls == 0)
        right.enable(context, false);
    return right.time(context);
}

/* In a task that runs every two milliseconds. */
static void in_a_task(void *context, bool on)
{
    if (!on && board->host.enabled)
        calls = 4000;
    else
        right.enable(context, on);
}

void wrong_off_at_once(struct simulated_board *spoilt)
{
    struct hal *hal = of(spoilt);
    hal->enable = in_a_task;
    hal->time = late_off;
}

static int16_t the_set_point(void *context)
{
    (void)context;
    return board->host.current;
}

void wrong_measured_flows(struct simulated_board *spoilt)
{
    of(spoilt)->measured_current = the_set_point;
}

static int16_t of_the_other_sign(void *context)
{
    return (int16_t)-right.measured_current(context);
}

void wrong_measured_flows__the_other_way(struct simulated_board *spoilt)
{
    of(spoilt)->measured_current = of_the_other_sign;
}

static uint8_t with_the_sync_outputs(void *context)
{
    return (uint8_t)(right.inputs(context) | HR_INPUT_SYNC_TRIAL);
}

void wrong_inputs_bits(struct simulated_board *spoilt)
{
    of(spoilt)->inputs = with_the_sync_outputs;
}

/* Right, and watched: whether it was ever switched on, and whether it is. */
bool ever_on, is_on;

static void watched_enable(void *context, bool on)
{
    ever_on = ever_on || on;
    is_on = on;
    right.enable(context, on);
}

void watch_enable(struct simulated_board *watched)
{
    of(watched)->enable = watched_enable;
    ever_on = is_on = false;
}

/* ------------------------------------------------------------------ link */

static size_t ending_its_text(void *context, uint8_t *into, size_t capacity)
{
    const size_t count = right.link_read(context, into, capacity);
    into[count] = 0;
    return count;
}

void wrong_read_room(struct simulated_board *spoilt)
{
    of(spoilt)->link_read = ending_its_text;
}

static size_t waiting_for_bytes(void *context, uint8_t *into, size_t capacity)
{
    if (board->host.input_count == 0)
        take_time(2000);
    return right.link_read(context, into, capacity);
}

void wrong_read_waits_not(struct simulated_board *spoilt)
{
    of(spoilt)->link_read = waiting_for_bytes;
}

/* A ring takes what it can. */
static bool taking_a_part(void *context, const uint8_t *frame, size_t count)
{
    const size_t room = board->host.output_room - board->host.output_count;
    return right.link_write(context, frame, count < room ? count : room) && count <= room;
}

void wrong_write_whole__torn(struct simulated_board *spoilt)
{
    of(spoilt)->link_write = taking_a_part;
}

static bool always_taken(void *context, const uint8_t *frame, size_t count)
{
    right.link_write(context, frame, count);
    return true;
}

void wrong_write_whole__dropped_unsaid(struct simulated_board *spoilt)
{
    of(spoilt)->link_write = always_taken;
}

static bool waiting_for_room(void *context, const uint8_t *frame, size_t count)
{
    while (board->host.output_room - board->host.output_count < count)
        simulated_board_time(right.context);
    return right.link_write(context, frame, count);
}

void wrong_write_waits_not(struct simulated_board *spoilt)
{
    of(spoilt)->link_write = waiting_for_room;
}

void wrong_write_room(struct simulated_board *spoilt)
{
    host_set_room(&spoilt->host, 4096);
}

/* ------------------------------------------------------------------ resets */

static void not_started(void *context, uint32_t bite_us)
{
    (void)context;
    (void)bite_us;
}

void wrong_watchdog_bites__never(struct simulated_board *spoilt)
{
    of(spoilt)->feed_watchdog = not_started;
}

/* By the main loop too. */
static uint64_t feeding_as_it_looks(void *context)
{
    right.feed_watchdog(context, 40000u);
    return right.time(context);
}

void wrong_watchdog_bites__fed_by_others(struct simulated_board *spoilt)
{
    of(spoilt)->time = feeding_as_it_looks;
}

static void always_for_40_ms(void *context, uint32_t bite_us)
{
    (void)bite_us;
    right.feed_watchdog(context, 40000u);
}

void wrong_watchdog_time__always_the_same(struct simulated_board *spoilt)
{
    of(spoilt)->feed_watchdog = always_for_40_ms;
}

static void in_half_microseconds(void *context, uint32_t bite_us)
{
    right.feed_watchdog(context, bite_us / 4u);
}

void wrong_watchdog_time__of_another_unit(struct simulated_board *spoilt)
{
    of(spoilt)->feed_watchdog = in_half_microseconds;
}

void wrong_reset_reported(struct simulated_board *spoilt)
{
    of(spoilt);
    spoilt->reports_reset = false;
}

static void going_on(void *context)
{
    (void)context;
}

void wrong_bootloader(struct simulated_board *spoilt)
{
    of(spoilt)->enter_bootloader = going_on;
}
