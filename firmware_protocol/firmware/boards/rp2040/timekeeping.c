#include "timekeeping.h"

#include "clocks.h"
#include "registers.h"

/* To 16 MHz, in sixteenths: 7 13/16 or 12 1/2 exactly (4.5.2.4, fractional division is exact on average). */
#define TIME_DIVIDER (CLOCK_HZ / 1000000u)
#define TICK_LONGEST 65536u
#define TICK_SHORTEST 2u /* counts: it alternates between two neighbours */
#define TICK_DIVIDER_LIMIT 255u

static struct {
    uint64_t now;    /* when last asked */
    uint32_t offset; /* of the fine count against 16 times the microseconds */
} clock;

static struct {
    uint32_t divider;
    uint32_t top;        /* counts of a period, rounded down, less one */
    uint32_t rest, rate; /* a period is top + 1 + rest / rate counts */
    uint32_t saved;      /* of rests, in 1 / rate */
} tick;

/* ------------------------------------------------------------------ device time */

void time_start(void)
{
    PWM_CONTROL(TIME_SLICE) = 0;
    PWM_DIVIDER(TIME_SLICE) = PWM_DIVIDED_BY(TIME_DIVIDER);
    PWM_TOP(TIME_SLICE) = 0xFFFFu;
    PWM_COUNTER(TIME_SLICE) = 0;
    PWM_CONTROL(TIME_SLICE) = PWM_ON;
    /* Both count in step; what lies between them is measured just behind a step of the slower one. */
    const uint32_t before = REGISTER(TIMER_RAW_LOW);
    uint32_t coarse;
    do {
        coarse = REGISTER(TIMER_RAW_LOW);
    } while (coarse == before);
    clock.offset = PWM_COUNTER(TIME_SLICE) - coarse * 16u;
    clock.now = clock.offset + coarse * 16u;
}

/* Modulo 2³²: the moment near 16 times the microseconds that has the fine count's 16 bits. */
static uint32_t join_counts(uint32_t fine, uint32_t coarse)
{
    const uint32_t about = coarse * 16u + clock.offset;
    return about + (uint32_t)(int16_t)(uint16_t)(fine - about);
}

uint64_t time_now(void)
{
    clock.now += (uint16_t)(PWM_COUNTER(TIME_SLICE) - (uint32_t)clock.now);
    return clock.now;
}

void time_look(void)
{
    clock.now += join_counts(PWM_COUNTER(TIME_SLICE), REGISTER(TIMER_RAW_LOW)) - (uint32_t)clock.now;
}

uint64_t time_of(uint32_t fine, uint32_t coarse)
{
    const uint64_t now = time_now();
    const uint64_t about = now - (uint64_t)(REGISTER(TIMER_RAW_LOW) - coarse) * 16u;
    return about + (uint64_t)(int16_t)(uint16_t)(fine - (uint32_t)about);
}

void stamp_read(const struct stamp *stamp, uint32_t *fine, uint32_t *coarse)
{
    /* The DMA writes one behind the other, within a tenth of a microsecond, and the next edge comes later. */
    do {
        *fine = stamp->fine;
        *coarse = stamp->coarse;
    } while (*fine != stamp->fine || *coarse != stamp->coarse);
}

/* ------------------------------------------------------------------ the tick */

static uint32_t next_top(void)
{
    tick.saved += tick.rest;
    if (tick.saved < tick.rate)
        return tick.top;
    tick.saved -= tick.rate;
    return tick.top + 1u;
}

bool tick_set_rate(uint32_t rate)
{
    const uint32_t divider = (CLOCK_HZ / TICK_LONGEST) / rate + 1u;
    if (rate == 0 || rate > CLOCK_HZ / TICK_SHORTEST || divider > TICK_DIVIDER_LIMIT)
        return false;
    tick.divider = divider;
    tick.rate = rate * divider;
    tick.top = CLOCK_HZ / tick.rate - 1u;
    tick.rest = CLOCK_HZ % tick.rate;
    tick.saved = 0;
    PWM_CONTROL(TICK_SLICE) = 0; /* what is written while it stands is active at once */
    PWM_DIVIDER(TICK_SLICE) = PWM_DIVIDED_BY(divider << 4);
    PWM_COUNTER(TICK_SLICE) = 0;
    PWM_TOP(TICK_SLICE) = next_top();
    PWM_WRAPPED = 1u << TICK_SLICE;
    PWM_CONTROL(TICK_SLICE) = PWM_ON;
    PWM_TOP(TICK_SLICE) = next_top();
    return true;
}

void tick_start(void)
{
    PWM_COUNTER(TICK_SLICE) = 0;
    PWM_WRAPPED = 1u << TICK_SLICE;
    PWM_INTERRUPTS = 1u << TICK_SLICE;
    INTERRUPT_PRIORITY(INTERRUPT_PWM_WRAP / 4u) &= ~(UINT32_C(0xFF) << 8u * (INTERRUPT_PWM_WRAP % 4u)); /* the highest */
    INTERRUPTS_FORGET = 1u << INTERRUPT_PWM_WRAP;
    INTERRUPTS_ENABLE = 1u << INTERRUPT_PWM_WRAP;
}

void tick_taken(void)
{
    time_look();
    PWM_WRAPPED = 1u << TICK_SLICE;
    if (tick.rest != 0)
        PWM_TOP(TICK_SLICE) = next_top(); /* active from the next wrap on (4.5.2.3) */
}

uint32_t tick_cycles_left(void)
{
    if (PWM_WRAPPED & 1u << TICK_SLICE)
        return 0;
    return (tick.top + 1u - PWM_COUNTER(TICK_SLICE)) * tick.divider; /* the period's longer kind ends at top + 1 */
}
