/* Magnitude and direction are the two outputs of one slice of the PWM block: both change at the same moment, when the slice
 * wraps, so that the sign never goes ahead of the magnitude. */
#include "amplifier.h"

#include "board_config.h"
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

/* Quanta at the largest duty, and cycles for one of them, times 2¹⁶: their product fits 32 bits. */
#define MOST_QUANTA (BOARD_FULL_SCALE / BOARD_CURRENT_QUANTUM_A)
#define MOST ((uint32_t)(MOST_QUANTA < 32768.0 ? MOST_QUANTA : 32768.0))
#define CYCLES_A_QUANTUM ((uint32_t)(SPAN / MOST_QUANTA * 65536.0 + 0.5))

#define VOLTS_A_STEP (3.3 / 4096.0) /* 4.9.3: 12 bits of ADC_AVDD */
#define MONITOR_ZERO ((int32_t)(BOARD_MONITOR_ZERO / VOLTS_A_STEP + 0.5))
#define QUANTA_A_STEP (VOLTS_A_STEP / BOARD_MONITOR_SCALE / BOARD_CURRENT_QUANTUM_A)
/* With so many fractional bits 4095 steps fit 31 bits. */
#define MONITOR_BITS (QUANTA_A_STEP < 15.0 && QUANTA_A_STEP > -15.0 ? 15 : 4)
#define MONITOR_GAIN ((int32_t)(QUANTA_A_STEP * (1 << MONITOR_BITS)))

static int16_t set_point;

void amplifier_start(void)
{
    pin_output(BOARD_ENABLE_PIN);
    PWM_CONTROL(SLICE) = 0;
    PWM_DIVIDER(SLICE) = PWM_DIVIDED_BY(16u);
    PWM_TOP(SLICE) = PERIOD - 1u;
    PWM_COMPARE(SLICE) = NO_CURRENT;
    PWM_COUNTER(SLICE) = 0;
    PWM_CONTROL(SLICE) = PWM_ON;
    pin_function(BOARD_PWM_PIN, GPIO_PWM);
    pin_function(BOARD_PWM_PIN + 1u, GPIO_PWM);
#ifdef BOARD_CURRENT_MONITOR_ADC
    PAD(ADC_FIRST_PIN) = PAD_OUTPUT_DISABLED; /* 4.9.2.3: no pulls, no digital input */
    ADC_CONTROL = ADC_ON;
    while (!(ADC_CONTROL & ADC_READY))
        continue;
    ADC_DIVIDER = 0; /* as fast as it can: a conversion takes 2 µs */
    ADC_CONTROL = ADC_ON | ADC_START_MANY;
#endif
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

void amplifier_set_current(int16_t quanta)
{
    PWM_COMPARE(SLICE) = compare_of(quanta);
    if (quanta == 0 && set_point != 0)
        PWM_COUNTER(SLICE) = PERIOD - 1u; /* a set-point becomes active at the wrap: this one now */
    set_point = quanta;
}

int16_t amplifier_measured_current(void)
{
#ifdef BOARD_CURRENT_MONITOR_ADC
    const int32_t quanta = ((int32_t)ADC_RESULT - MONITOR_ZERO) * MONITOR_GAIN >> MONITOR_BITS;
    return (int16_t)(quanta > INT16_MAX ? INT16_MAX : quanta < INT16_MIN ? INT16_MIN : quanta);
#else
    return set_point;
#endif
}

void amplifier_enable(bool on)
{
    if (on)
        amplifier_set_current(0);
    pin_write(BOARD_ENABLE_PIN, on);
}
