/* Magnitude and direction are the two outputs of one slice of the PWM block: both change at the same moment, when the slice
 * wraps, so that the sign never goes ahead of the magnitude. */
#include "output.h"

#ifdef BOARD_OUTPUT_PWM

#include "clocks.h"
#include "pins.h"
#include "registers.h"

#if BOARD_PWM_PIN % 2 != 0 || BOARD_PWM_PIN % 16 >= 12
#error "pwm_pin must be an even pin of slices 0 to 5: 0 to 10 or 16 to 26"
#endif

#if CLOCK_HZ / BOARD_PWM_FREQUENCY > 65535
#error "pwm_frequency is too low: its period does not fit the 16 bits of a slice at this clock"
#endif

#define SLICE (BOARD_PWM_PIN / 2u % 8u)
#define PERIOD (CLOCK_HZ / BOARD_PWM_FREQUENCY) /* cycles: the steps of the set-point */

#define LOW_DUTY (BOARD_DUTY_MINIMUM * PERIOD)
#define HIGH_DUTY (BOARD_DUTY_MAXIMUM * PERIOD)
#ifdef BOARD_SET_POINT_OFFSET
#define NO_CURRENT ((uint32_t)((LOW_DUTY + HIGH_DUTY) / 2.0 + 0.5))
#define SPAN ((HIGH_DUTY - LOW_DUTY) / 2.0)
#else
#define NO_CURRENT ((uint32_t)(LOW_DUTY + 0.5))
#define SPAN (HIGH_DUTY - LOW_DUTY)
#endif

/* Cycles for a quantum, times 2¹⁶: with MOST their product fits 32 bits. */
#define CYCLES_A_QUANTUM ((uint32_t)(SPAN / MOST_QUANTA * 65536.0 + 0.5))

static int16_t active;

void output_start(void)
{
    PWM_CONTROL(SLICE) = 0;
    PWM_DIVIDER(SLICE) = PWM_DIVIDED_BY(16u);
    PWM_TOP(SLICE) = PERIOD - 1u;
    PWM_COMPARE(SLICE) = NO_CURRENT;
    PWM_COUNTER(SLICE) = 0;
    PWM_CONTROL(SLICE) = PWM_ON;
    pin_function(BOARD_PWM_PIN, GPIO_PWM);
    pin_function(BOARD_PWM_PIN + 1u, GPIO_PWM);
}

static uint32_t compare_of(int16_t quanta)
{
    const uint32_t wanted = (uint32_t)(quanta < 0 ? -(int32_t)quanta : quanta);
    const uint32_t width = ((wanted < MOST ? wanted : MOST) * CYCLES_A_QUANTUM + 0x8000u) >> 16;
#ifdef BOARD_SET_POINT_OFFSET
    return quanta < 0 ? NO_CURRENT - width : NO_CURRENT + width;
#else
    return NO_CURRENT + width + (quanta < 0 ? PERIOD << 16 : 0u); /* the second output high or low throughout */
#endif
}

void output_set(int16_t quanta)
{
    PWM_COMPARE(SLICE) = compare_of(quanta);
    if (quanta == 0 && active != 0)
        PWM_COUNTER(SLICE) = PERIOD - 1u; /* a set-point becomes active at the wrap: this one now */
    active = quanta;
}

int16_t output_active(void)
{
    return active;
}

#endif
