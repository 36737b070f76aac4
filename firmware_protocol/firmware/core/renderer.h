/* The law on the device: its parameters, its state and its last current. */
#ifndef HR_RENDERER_H
#define HR_RENDERER_H

#include <stdbool.h>
#include <stdint.h>

#include "../law/excitation.h"
#include "../law/law.h"

struct renderer {
    bool there;      /* the device runs a law in a session; false: the host does */
    bool begun;      /* it has seen a sample */
    uint8_t phase;   /* law_phase of the last tick, 0 before the first */
    int16_t current; /* commanded by the law (quanta) */
    uint32_t flags;  /* of its last tick */
    uint32_t index;  /* of that tick */
    bool ready;      /* its excitation is worked out, or it has none */
    law_parameters parameters;
    law_state state;
    law_excitation_work work;
};

/* Run this law, checked by law_settings_read, from the next session on. `table` is the board's memory for an
 * excitation. */
void renderer_configure(struct renderer *renderer, const law_parameters *parameters, int16_t *table);

/* Work on the excitation for so many cosines, until it is ready. */
void renderer_prepare(struct renderer *renderer, uint32_t cosines);

/* Disable the law on the device: the host computes it. */
void renderer_disable(struct renderer *renderer);

/* Reset the law to its state before the first sample, with zero current. */
void renderer_reset(struct renderer *renderer);

/* Change the wall between two ticks: the parameters may differ in the live ones only. */
void renderer_change(struct renderer *renderer, const law_parameters *parameters);

/* Run it on the sample of a tick. Returns faults as bits 1 << code. */
uint32_t renderer_run(struct renderer *renderer, int32_t count, int32_t active, uint32_t index);

#endif
