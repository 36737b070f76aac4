/* A program that does nothing but fill the USB: ticks that take 40 % of the processor, every so many of them a frame as long
 * as BATCH's longest. It begins when the host has spoken: the ticks a second (Hz), little endian. */
#include "board_config.h"
#include "clocks.h"
#include "registers.h"
#include "timekeeping.h"
#include "usb.h"

#define SAMPLES 45u /* in a frame of the layout with measured current */
#define FRAME_BYTES 254u
#define BURNT_PERCENT 40u
#define CYCLES_A_TURN 4u

static struct {
    uint8_t frame[FRAME_BYTES]; /* at a whole word, as BATCH is */
    bool runs;
    uint32_t turns; /* of the loop that burns */
    volatile uint32_t ticks;
} stream __attribute__((aligned(4)));

static uint32_t to_host_words[8192];

/* Number of the frame in eight digits, whatever behind them, a delimiter. */
static void fill(uint32_t number)
{
    for (unsigned i = 0; i < FRAME_BYTES; i++)
        stream.frame[i] = (uint8_t)(1u + (number + i) % 255u);
    for (unsigned i = 0; i < 8u; i++)
        stream.frame[i] = (uint8_t) "0123456789ABCDEF"[number >> 4u * (7u - i) & 15u];
    stream.frame[FRAME_BYTES - 1u] = 0;
}

void tick_interrupt(void)
{
    tick_taken();
    SIO_OUT_SET = 1u << BOARD_SYNC_OUT_PIN;
    for (uint32_t i = stream.turns; i > 0; i--)
        __asm volatile("nop");
    if (stream.runs && ++stream.ticks % SAMPLES == 0)
        usb_write(stream.frame, FRAME_BYTES);
    SIO_OUT_CLEAR = 1u << BOARD_SYNC_OUT_PIN;
}

int main(void)
{
    clocks_release(RESET_IO_BANK0 | RESET_PADS_BANK0 | RESET_DMA | RESET_PWM | RESET_TIMER);
    GPIO_CONTROL(BOARD_SYNC_OUT_PIN) = GPIO_SIO;
    SIO_DRIVE_SET = 1u << BOARD_SYNC_OUT_PIN;
    usb_start(1, to_host_words, sizeof to_host_words / sizeof *to_host_words);
    time_start();
    uint32_t rate = 1000;
    tick_set_rate(rate);
    tick_start();
    __asm volatile("cpsie i" ::: "memory");
    uint8_t asked[4];
    while (usb_read(asked, sizeof asked) < sizeof asked)
        ;
    rate = (uint32_t)(asked[0] | asked[1] << 8 | asked[2] << 16);
    __asm volatile("cpsid i" ::: "memory");
    tick_set_rate(rate);
    stream.turns = CLOCK_HZ / rate * BURNT_PERCENT / 100u / CYCLES_A_TURN;
    fill(0);
    stream.runs = true;
    __asm volatile("cpsie i" ::: "memory");
    for (uint32_t told = 0;; ) {
        const uint32_t frames = stream.ticks / SAMPLES;
        if (frames != told)
            fill(told = frames); /* long before the next one leaves */
    }
}
