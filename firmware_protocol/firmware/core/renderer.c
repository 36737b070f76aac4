#include "renderer.h"

#include "protocol.h"

static bool is_same(const law_excitation *a, const law_excitation *b)
{
    return a->lines == b->lines && a->first == b->first && a->step == b->step && a->period == b->period
           && a->ramp == b->ramp && a->amplitude == b->amplitude && a->bits == b->bits && a->phases == b->phases
           && a->seed == b->seed;
}

/* A table that is complete or being computed is not started again, because it takes seconds. */
void renderer_configure(struct renderer *renderer, const law_parameters *parameters, int16_t *table)
{
    renderer->there = true;
    renderer->parameters = *parameters;
    if (!is_same(&parameters->excitation, &renderer->work.p) || table != renderer->work.table) {
        law_excitation_begin(&renderer->work, &parameters->excitation, table);
        renderer->ready = law_excitation_continue(&renderer->work, 0);
    }
    renderer_reset(renderer);
}

void renderer_prepare(struct renderer *renderer, uint32_t cosines)
{
    renderer->ready = law_excitation_continue(&renderer->work, cosines);
}

void renderer_disable(struct renderer *renderer)
{
    renderer->there = false;
    renderer->begun = false;
    renderer->phase = LAW_WAIT;
    renderer->flags = 0;
    renderer->current = 0;
}

void renderer_reset(struct renderer *renderer)
{
    law_reset(&renderer->state, &renderer->parameters, renderer->work.table);
    renderer->begun = false;
    renderer->phase = LAW_WAIT;
    renderer->flags = 0;
    renderer->current = 0;
}

void renderer_change(struct renderer *renderer, const law_parameters *parameters)
{
    renderer->parameters = *parameters;
}

uint32_t renderer_run(struct renderer *renderer, int32_t count, int32_t active, uint32_t index)
{
    const law_input input = {
        .count = count,
        .elapsed_ticks = renderer->begun ? index - renderer->index : 1u,
        .active = active,
    };
    const law_output output = law_tick(&renderer->state, &renderer->parameters, &input);
    renderer->begun = true;
    renderer->index = index;
    renderer->current = (int16_t)output.current;
    renderer->flags = output.flags;
    renderer->phase = (uint8_t)output.phase;
    return output.flags & LAW_NONFINITE ? UINT32_C(1) << HR_FAULT_NON_FINITE : 0u;
}
