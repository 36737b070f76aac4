/* Change of parameters while the device is armed, one step in each device_poll: all at once would delay the tick. */
#ifndef HR_LIVE_CHANGE_H
#define HR_LIVE_CHANGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../law/law.h"
#include "assembler.h"
#include "configuration.h"
#include "hal.h"
#include "renderer.h"

enum live_step {
    LIVE_NOTHING, /* no change is in progress */
    LIVE_SUM,     /* the block is checked */
    LIVE_ENTRIES, /* the entries of the block are read */
    LIVE_CHECK,
    LIVE_LAW, /* as its parameters will be */
    LIVE_CRC,
    LIVE_WALL,   /* the tick from which on the law has them */
    LIVE_VALUES, /* and then any reader */
    LIVE_DONE,
};

struct live_change {
    uint8_t step; /* enum live_step */
    uint8_t session;
    uint16_t nonce;
    uint16_t at; /* bytes of the block, or parameters, that are done in this step */
    uint32_t crc;
    uint32_t sample_index; /* first tick that sees it */
    struct refusal refusal;
    law_parameters law;
    struct candidate candidate;
};

/* The parts of the device that a change reads and writes, and the device's state between two ticks. */
struct live_change_of {
    const struct board *board;
    const struct hal *hal;
    const struct assembler *assembler; /* with the block */
    struct configuration *configuration;
    struct renderer *renderer;
    uint32_t sample_index;
    int32_t count;
    uint8_t state; /* enum hr_state */
    bool armed;
};

/* Begin a change with the parameter block in `assembler`, for the request with this nonce. */
void live_change_begin(struct live_change *change, struct assembler *assembler, uint16_t nonce, uint8_t session);

/* Do one step of the change; returns true after the last step, when the change must be acknowledged. */
bool live_change_continue(struct live_change *change, const struct live_change_of *of);

#endif
