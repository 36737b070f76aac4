/* What a port gives the core: one struct of functions, each called with `context`, none of which may block.
 *
 * Device time counts 1/16 µs since power-up, 64 bits wide, and never steps back. A port with a 32-bit counter
 * extends it. */
#ifndef HR_HAL_H
#define HR_HAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../law/law.h"

struct hal {
    void *context;

    /* Device time now. */
    uint64_t (*time)(void *context);

    /* The encoder: its count, device time of its last edge (0 before the first), and whether it has seen an illegal
     * transition since the last question. The edge may be asked for behind the count: it may be younger. */
    int32_t (*encoder_count)(void *context);
    uint64_t (*edge_time)(void *context);
    bool (*encoder_failed)(void *context);

    /* The encoder's index: how many of its pulses have begun since power-up, modulo 2³², and the count where the last of
     * them did; NULL: there is none. Asked for between two ticks. */
    uint32_t (*index_edges)(void *context, int32_t *count);

    /* The amplifier: set-point and measurement (quanta), enable. Switched on, it starts from a set-point of zero. */
    void (*set_current)(void *context, int16_t quanta);
    int16_t (*measured_current)(void *context);
    void (*enable)(void *context, bool on);

    /* Whether the port lets what it drives render the wall of a law (LAW_ELSEWHERE), so many ticks a second. It does so
     * beside the set-point, and reports the current of both (device_tick_driven). NULL: it cannot. */
    bool (*renders)(void *context, const law_parameters *law, uint32_t rate);

    /* Whether the amplifier can be switched on at once; asked before arming, again and again. One that takes its time
     * begins then, without effort, and gives it up when it is not asked for a while. NULL: it always can. */
    bool (*amplifier_ready)(void *context);

    /* Bits of enum hr_input. */
    uint8_t (*inputs)(void *context);

    /* Tick at another rate (Hz) from the last tick on. False, and no change, for one that the timer cannot do. */
    bool (*set_rate)(void *context, uint32_t rate);

    /* Bytes of the host: those that are there, at most `capacity`; and a whole frame to it, taken or dropped in one:
     * returns which. The core does not look at that; a port that wants to know counts what it drops. */
    size_t (*link_read)(void *context, uint8_t *into, size_t capacity);
    bool (*link_write)(void *context, const uint8_t *frame, size_t count);

    /* The hardware watchdog, fed by the tick alone: it bites after so long (µs) unless it is fed again, 50 ms at most. */
    void (*feed_watchdog)(void *context, uint32_t bite_us);

    /* Reset into the boot loader, which takes another program; NULL: there is none. */
    void (*enter_bootloader)(void *context);

    /* Pins, bits of enum hr_sync: an oscilloscope shows rate, jitter and load, and what happens when. Called when they
     * change; low before. */
    void (*sync)(void *context, uint8_t bits);

    /* Device time of the last rising edge of the sync input; 0 before the first. */
    uint64_t (*sync_time)(void *context);
};

#endif
