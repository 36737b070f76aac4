/* The functions that a port provides to the core. Each is called with `context`, and none may block.
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

    /* Return the device time now (1/16 µs). */
    uint64_t (*time)(void *context);

    /* The encoder: return the count; the device time of the last edge (0 before the first); true if an illegal
     * transition occurred since the last call. The edge is read after the count, so it may be newer. */
    int32_t (*encoder_count)(void *context);
    uint64_t (*edge_time)(void *context);
    bool (*encoder_failed)(void *context);

    /* The encoder's index: return how many index pulses have begun since power-up, modulo 2³², and set `*count` to the
     * count at the last one. NULL: no index. Called between two ticks. */
    uint32_t (*index_edges)(void *context, int32_t *count);

    /* The amplifier: set the current, return the measured current (quanta), switch on or off. After switching on, the
     * set-point is zero. */
    void (*set_current)(void *context, int16_t quanta);
    int16_t (*measured_current)(void *context);
    void (*enable)(void *context, bool on);

    /* Return true if the drive behind the port can render the wall of this law itself (LAW_ELSEWHERE), at this tick rate.
     * It then does so in addition to the set-point, and device_tick_driven gets the current of both. NULL: it cannot. */
    bool (*renders)(void *context, const law_parameters *law, uint32_t rate);

    /* Return true if the amplifier can be switched on at once. Called repeatedly before arming: an amplifier that takes
     * time to prepare begins at the first call, without effort, and stops when the calls stop. NULL: always ready. */
    bool (*amplifier_ready)(void *context);

    /* Return the levels of the inputs, as bits of enum hr_input. */
    uint8_t (*inputs)(void *context);

    /* Change the tick rate (Hz), counted from the last tick. Returns false, and changes nothing, if the timer cannot
     * generate it. */
    bool (*set_rate)(void *context, uint32_t rate);

    /* Read the available bytes from the host, at most `capacity`. Write a whole frame to the host, or drop it and
     * return false; the core ignores the result, a port may count the dropped frames. */
    size_t (*link_read)(void *context, uint8_t *into, size_t capacity);
    bool (*link_write)(void *context, const uint8_t *frame, size_t count);

    /* Feed the hardware watchdog, which resets the board after this timeout (µs, at most 50 ms). Only the tick calls
     * it. */
    void (*feed_watchdog)(void *context, uint32_t bite_us);

    /* Reset the board into its boot loader, which loads another program; NULL: no boot loader. */
    void (*enter_bootloader)(void *context);

    /* Set the sync outputs (bits of enum hr_sync), on which an oscilloscope shows tick rate, jitter, load and trial.
     * Called when they change; before the first call all are low. */
    void (*sync)(void *context, uint8_t bits);

    /* Return the device time of the last rising edge of the sync input; 0 before the first. */
    uint64_t (*sync_time)(void *context);
};

#endif
