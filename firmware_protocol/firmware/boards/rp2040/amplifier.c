#include "amplifier.h"

#include "board_config.h"
#include "output.h"
#include "pins.h"
#include "registers.h"

#define VOLTS_A_STEP (3.3 / 4096.0) /* 4.9.3: 12 bits of ADC_AVDD */
#define MONITOR_ZERO ((int32_t)(BOARD_MONITOR_ZERO / VOLTS_A_STEP + 0.5))
#define QUANTA_A_STEP (VOLTS_A_STEP / BOARD_MONITOR_SCALE / BOARD_CURRENT_QUANTUM_A)
/* With so many fractional bits 4095 steps fit 31 bits. */
#define MONITOR_BITS (QUANTA_A_STEP < 15.0 && QUANTA_A_STEP > -15.0 ? 15 : 4)
#define MONITOR_GAIN ((int32_t)(QUANTA_A_STEP * (1 << MONITOR_BITS)))

void amplifier_start(void)
{
    pin_output(BOARD_ENABLE_PIN);
    output_start();
#ifdef BOARD_CURRENT_MONITOR_ADC
    PAD(ADC_FIRST_PIN) = PAD_OUTPUT_DISABLED; /* 4.9.2.3: no pulls, no digital input */
    ADC_CONTROL = ADC_ON;
    while (!(ADC_CONTROL & ADC_READY))
        continue;
    ADC_DIVIDER = 0; /* as fast as it can: a conversion takes 2 µs */
    ADC_CONTROL = ADC_ON | ADC_START_MANY;
#endif
}

void amplifier_set_current(int16_t quanta)
{
    output_set(quanta);
}

int16_t amplifier_measured_current(void)
{
#ifdef BOARD_CURRENT_MONITOR_ADC
    const int32_t quanta = ((int32_t)ADC_RESULT - MONITOR_ZERO) * MONITOR_GAIN >> MONITOR_BITS;
    return (int16_t)(quanta > INT16_MAX ? INT16_MAX : quanta < INT16_MIN ? INT16_MIN : quanta);
#else
    return output_active();
#endif
}

void amplifier_enable(bool on)
{
    if (on)
        amplifier_set_current(0);
    pin_write(BOARD_ENABLE_PIN, on);
    if (on)
        output_begin();
}
