#include "pins.h"

#include "board_config.h"
#include "protocol.h"
#include "registers.h"

#define SYNC_OUTPUTS 7u

void pin_function(uint32_t pin, uint32_t function)
{
    GPIO_CONTROL(pin) = function;
}

/* The pull-down stays: it holds the pin low while the board is in reset and until the program is here. */
void pin_output(uint32_t pin)
{
    SIO_OUT_CLEAR = 1u << pin;
    SIO_DRIVE_SET = 1u << pin;
    pin_function(pin, GPIO_SIO);
}

void pin_write(uint32_t pin, bool high)
{
    if (high)
        SIO_OUT_SET = 1u << pin;
    else
        SIO_OUT_CLEAR = 1u << pin;
}

static void input(uint32_t pin, uint32_t pull)
{
    PAD(pin) = PAD_INPUT | PAD_SCHMITT | PAD_4_MA | pull;
    pin_function(pin, GPIO_SIO);
}

void pins_start(void)
{
    input(BOARD_ENCODER_PIN, PAD_PULL_UP);
    input(BOARD_ENCODER_PIN + 1u, PAD_PULL_UP);
#if defined(BOARD_ENCODER_LINES_COMPLEMENTARY)
    input(BOARD_ENCODER_COMPLEMENT_PIN, PAD_PULL_UP);
    input(BOARD_ENCODER_COMPLEMENT_PIN + 1u, PAD_PULL_UP);
#endif
    input(BOARD_HOLD_TO_RUN_PIN, PAD_PULL_UP);
    input(BOARD_EMERGENCY_STOP_PIN, PAD_PULL_UP);
    input(BOARD_SYNC_IN_PIN, PAD_PULL_DOWN);
#if defined(BOARD_ENCODER_INDEX_WIRED)
    input(BOARD_ENCODER_INDEX_PIN, PAD_PULL_UP);
#endif
#if defined(BOARD_LIMIT_SWITCH_WIRED)
    input(BOARD_LIMIT_SWITCH_PIN, PAD_PULL_UP);
#endif
    for (uint32_t i = 0; i < 3u; i++)
        pin_output(BOARD_SYNC_OUT_PIN + i);
}

uint8_t pins_inputs(void)
{
    const uint32_t levels = SIO_IN;
    uint32_t bits = 0;
    if (!(levels & 1u << BOARD_HOLD_TO_RUN_PIN))
        bits |= HR_INPUT_HOLD_TO_RUN;
    if (levels & 1u << BOARD_EMERGENCY_STOP_PIN)
        bits |= HR_INPUT_EMERGENCY_STOP;
    if (levels & 1u << BOARD_SYNC_IN_PIN)
        bits |= HR_INPUT_SYNC;
#if defined(BOARD_LIMIT_SWITCH_WIRED)
    if (levels & 1u << BOARD_LIMIT_SWITCH_PIN)
        bits |= HR_INPUT_LIMIT_SWITCH;
#endif
    return (uint8_t)bits;
}

void pins_sync(uint8_t bits)
{
    SIO_OUT_SET = (uint32_t)bits << BOARD_SYNC_OUT_PIN;
    SIO_OUT_CLEAR = (~(uint32_t)bits & SYNC_OUTPUTS) << BOARD_SYNC_OUT_PIN;
}
