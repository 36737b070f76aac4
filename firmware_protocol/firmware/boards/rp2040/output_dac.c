/* A voltage of ±10 V from an AD5761R (data sheets of AD5761R, Rev. C, and AD5761R-EP, Rev. 0). A state machine of PIO shifts
 * out frames of 24 bits, which the converter takes at the end of each; the processor writes one word and continues.
 *
 * The converter's RESET is the enable wire: while that is low, for whatever reason, the output is clamped to ground, and
 * the converter knows no range (EP, Table 4). CLEAR would do so at an edge only, and let the next frame in. So at rest
 * each tick sends the range again, and a converter that was in reset, or without its supply, is ready for the next
 * current; until then it gives none. */
#include "output.h"

#ifdef BOARD_OUTPUT_DAC

#include "clocks.h"
#include "pins.h"
#include "registers.h"

#define SYNC_PIN BOARD_DAC_PIN
#define DATA_PIN (BOARD_DAC_PIN + 2u)

/* Rev. C, Table 15 and no-OS ad5761r.h: frames, most significant bit first, are the upper 24 bits of a word. */
#define WRITE_AND_UPDATE (3u << 24)
#define CONTROL (4u << 24)
#define CLEARS_TO_MIDDLE (1u << 9)
#define OWN_REFERENCE (1u << 5)
#define BEGINS_IN_MIDDLE (1u << 3)
#define PLUS_MINUS_10_V 0u
#define RANGE (CONTROL | (CLEARS_TO_MIDDLE | OWN_REFERENCE | BEGINS_IN_MIDDLE | PLUS_MINUS_10_V) << 8)

/* 3.4: instructions of PIO; two pins of side-set, SYNC and SCLK, leave up to seven cycles of delay. */
#define SYNC_HIGH (1u << 11)
#define CLOCK_HIGH (1u << 12)
#define THEN_WAIT(cycles) ((cycles) << 8)
#define PULL 0x80A0u /* waits for a word */
#define SET_X(value) (0xE020u | (value))
#define SET_LEVELS(levels) (0xE000u | (levels))
#define SET_OUTPUTS(pins) (0xE080u | (pins))
#define OUT_TO_PIN 0x6001u /* one bit */
#define JUMP_X_DECREMENT(to) (0x0040u | (to))

enum { REST, BEGIN, BIT, BIT_ENDS };

/* An instruction takes 10 ns at 200 MHz, a bit four of them: 25 MHz, of the 50 that the converter takes. It looks at SDI
 * when SCLK falls. */
static const uint16_t program[] = {
    [REST] = PULL | SYNC_HIGH | THEN_WAIT(7u),
    [BEGIN] = SET_X(23u) | THEN_WAIT(1u),
    [BIT] = OUT_TO_PIN | CLOCK_HIGH | THEN_WAIT(1u),
    [BIT_ENDS] = JUMP_X_DECREMENT(BIT) | THEN_WAIT(1u),
};

/* Volts at full scale are the converter's last step but a half: 31 ppm less than 10. Steps for a quantum, times 2¹⁶: with
 * MOST their product fits 31 bits. */
#define STEPS_A_QUANTUM ((int32_t)(32767.0 / MOST_QUANTA * 65536.0 + 0.5))
#define MIDDLE 0x80008000u /* 32768, and a half for rounding, times 2¹⁶ */

static int16_t active;

void output_start(void)
{
    clocks_release(RESET_PIO1);
    for (uint32_t i = 0; i < sizeof program / sizeof program[0]; i++)
        PIO1_MEMORY(i) = program[i];
    PIO1_DIVIDER = 2u * PIO_NOT_DIVIDED;
    PIO1_EXECUTION = PIO_WRAP(REST, BIT_ENDS);
    PIO1_SHIFTING = 0; /* to the left */
    PIO1_PINS = PIO_SET_FROM(SYNC_PIN, 3u);
    PIO1_INSTRUCTION = SET_LEVELS(1u); /* SYNC */
    PIO1_INSTRUCTION = SET_OUTPUTS(7u);
    PIO1_PINS = PIO_SIDE_SET_FROM(SYNC_PIN, 2u) | PIO_OUT_FROM(DATA_PIN, 1u);
    for (uint32_t pin = SYNC_PIN; pin <= DATA_PIN; pin++)
        pin_function(pin, GPIO_PIO1);
    PIO1_CONTROL = 1u;
}

static uint32_t frame_of(int32_t quanta)
{
    const int32_t most = (int32_t)MOST;
    if ((uint32_t)(quanta + most) > 2u * MOST)
        quanta = quanta < 0 ? -most : most;
    return WRITE_AND_UPDATE + (((uint32_t)(quanta * STEPS_A_QUANTUM) + MIDDLE) >> 8);
}

void output_set(int16_t quanta)
{
    PIO1_SEND = quanta == 0 && active == 0 ? RANGE : frame_of(quanta);
    active = quanta;
}

int16_t output_active(void)
{
    return active;
}

void output_begin(void)
{
    PIO1_SEND = RANGE;
}

bool output_stalled(void)
{
    const uint32_t flags = PIO1_DEBUG; /* since they were cleared; this one comes back as long as the machine rests */
    PIO1_DEBUG = flags;
    return !(flags & PIO1_NOTHING_TO_SEND);
}

#endif
