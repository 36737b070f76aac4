#include "monitor.h"

#include <math.h>

#include "protocol.h"

/* An automated rig may be at rest under an effort of up to the described friction and a twentieth of the limit, which
 * allows for friction above the description. */
#define LARGEST_SHARE 5
#define FRICTION_SHARE 0.25 /* a twentieth, times LARGEST_SHARE */

/* A rig under a large effort must show an edge within three times what the free rig takes for two counts. */
#define STALL_MARGIN 3.0
#define SHORTEST_STALL_S 5e-3
#define NEVER UINT32_MAX

#define FAULT(name) (UINT32_C(1) << HR_FAULT_##name)

/* Time (s) after which a free rig under a steady current must have shown an encoder edge; negative for never.
 * The effort less friction moves the whole inertia; viscous and electrical lag add their times. */
static double stall_s(const struct mechanics *m, double current)
{
    const double driving = current * m->effort_quantum;
    const double effort = (driving < m->effort_limit ? driving : m->effort_limit) - m->friction;
    if (!(effort > 0.0))
        return -1.0;
    const double moving_s = sqrt(2.0 * m->inertia * m->travel / effort) + m->travel * m->damping / effort + m->lag_s;
    const double stall = STALL_MARGIN * moving_s;
    return stall > SHORTEST_STALL_S ? stall : SHORTEST_STALL_S;
}

/* LARGEST_SHARE times the effort above which a rig must move (quanta). */
static int32_t large_effort(const struct mechanics *m, uint16_t limit)
{
    const double large = LARGEST_SHARE * m->friction / m->effort_quantum + FRICTION_SHARE * limit;
    const int32_t most = LARGEST_SHARE * (int32_t)limit;
    return large < (double)most ? (int32_t)large : most;
}

static uint32_t stall_ticks(const struct board *board, const struct monitor_settings *settings, int32_t large)
{
    if (settings->hold_to_run)
        return NEVER; /* a person has the handle, and can hold it still */
    const double stall = stall_s(&board->mechanics, large / (double)LARGEST_SHARE);
    const double ticks = ceil(stall * settings->rate);
    return stall < 0.0 || ticks >= (double)NEVER ? NEVER : (uint32_t)ticks;
}

/* 5 ms in ticks: to the nearest whole number, halves to even, at least one. */
static uint16_t window_ticks(uint32_t rate)
{
    const uint32_t whole = rate / HR_SPEED_WINDOWS_A_SECOND;
    const uint32_t twice_rest = rate % HR_SPEED_WINDOWS_A_SECOND * 2u;
    const bool up = twice_rest > HR_SPEED_WINDOWS_A_SECOND
                    || (twice_rest == HR_SPEED_WINDOWS_A_SECOND && whole % 2u == 1u);
    const uint32_t ticks = whole + (up ? 1u : 0u);
    return (uint16_t)(ticks > 0 ? ticks : 1u);
}

static uint32_t at_most_32(uint64_t value)
{
    return value < UINT32_MAX ? (uint32_t)value : UINT32_MAX;
}

/* Thresholds become whole counts once, here; a tick compares integers. The ends of the speed window may each lie
 * anywhere in their encoder cells, hence one count more. */
static void configure_motion(struct monitor *monitor, const struct monitor_settings *settings)
{
    const uint64_t travel = (uint64_t)settings->speed_limit * monitor->ticks;
    monitor->fastest = at_most_32(travel / settings->rate + 1u);
    monitor->near_fastest = at_most_32(travel * 9u / (settings->rate * UINT64_C(10)) + 1u); /* from 90 % STATE warns */
    monitor->first = settings->window_minimum;
    monitor->last = settings->window_maximum;
    const int64_t margin = ((int64_t)monitor->last - monitor->first + 19) / 20; /* 5 % at each end */
    monitor->near_first = (int32_t)(monitor->first + margin);
    monitor->near_last = (int32_t)(monitor->last - margin);
}

void monitor_configure(struct monitor *monitor, const struct board *board, const struct monitor_settings *settings,
                       int32_t count)
{
    monitor->encoder_sign = board->encoder_sign;
    monitor->over_current = (int16_t)(board->over_current < INT16_MAX ? board->over_current : INT16_MAX);
    monitor->large = large_effort(&board->mechanics, settings->current_limit);
    monitor->stall_ticks = stall_ticks(board, settings, monitor->large);
    monitor->ticks = window_ticks(settings->rate);
    configure_motion(monitor, settings);
    for (uint16_t i = 0; i < monitor->ticks; i++)
        monitor->counts[i] = count;
    monitor->slot = 0;
    monitor_forget(monitor);
}

void monitor_forget(struct monitor *monitor)
{
    monitor->driven = 0;
    monitor->still = 0;
    monitor->pushed = 0;
    monitor->peaks = 0;
}

bool monitor_in_window(const struct monitor *monitor, int32_t count)
{
    return count >= monitor->first && count <= monitor->last;
}

/* Count the ticks of large effort along the motion, and those on two neighbouring counts, which is all that a dead
 * channel shows of any motion; return true when there are too many of the latter.
 * `direction` is that of the motion in the window, 0 for none. */
static uint32_t runaway(struct monitor *monitor, int16_t current, int32_t direction, bool stood)
{
    const int32_t five = LARGEST_SHARE * (int32_t)current;
    if (five >= -monitor->large && five <= monitor->large) {
        monitor->driven = 0;
        monitor->still = 0;
        return 0;
    }
    const int8_t push = current > 0 ? 1 : -1;
    monitor->driven = direction == push * monitor->encoder_sign ? monitor->driven + 1u : 0u;
    monitor->still = stood && push == monitor->pushed ? monitor->still + 1u : 0u;
    monitor->pushed = push;
    return monitor->still > monitor->stall_ticks ? FAULT(RUNAWAY) : 0u;
}

static uint32_t speed(struct monitor *monitor, uint32_t distance)
{
    if (distance <= monitor->near_fastest)
        return 0;
    monitor->flags |= HR_LIMIT_SPEED;
    if (distance <= monitor->fastest)
        return 0;
    return monitor->driven >= monitor->ticks ? FAULT(OVER_SPEED) | FAULT(RUNAWAY) : FAULT(OVER_SPEED);
}

static uint32_t window(struct monitor *monitor, int32_t count)
{
    if (count >= monitor->near_first && count <= monitor->near_last)
        return 0;
    monitor->flags |= HR_LIMIT_POSITION;
    return monitor_in_window(monitor, count) ? 0u : FAULT(POSITION_WINDOW);
}

/* Two of three: one alone is a spike of the converter. */
static uint32_t over_current(struct monitor *monitor, int16_t measured)
{
    const uint32_t high = measured > monitor->over_current || measured < -monitor->over_current ? 1u : 0u;
    const uint32_t before = monitor->peaks;
    monitor->peaks = (uint8_t)((before << 1 | high) & 3u);
    return high + (before & 1u) + (before >> 1) >= 2u ? FAULT(OVER_CURRENT) : 0u;
}

uint32_t monitor_check(struct monitor *monitor, int32_t count, bool stood, int16_t current, int16_t measured)
{
    const uint32_t slot = monitor->slot, next = slot + 1u < monitor->ticks ? slot + 1u : 0u;
    const int32_t before = monitor->counts[slot];
    const int32_t direction = count > before ? 1 : count < before ? -1 : 0;
    /* Two counts of 32 bits are less than 2³² apart. */
    const uint32_t distance = direction < 0 ? (uint32_t)before - (uint32_t)count : (uint32_t)count - (uint32_t)before;
    monitor->counts[slot] = count;
    monitor->slot = (uint16_t)next;
    uint32_t faults = runaway(monitor, current, direction, stood);
    faults |= speed(monitor, distance);
    faults |= window(monitor, count);
    return faults | over_current(monitor, measured);
}
