#include "renderer.h"

#include "protocol.h"

void renderer_configure(struct renderer *renderer, const law_parameters *parameters)
{
    renderer->there = true;
    renderer->parameters = *parameters;
    renderer_reset(renderer);
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
    law_reset(&renderer->state, &renderer->parameters);
    renderer->begun = false;
    renderer->phase = LAW_WAIT;
    renderer->flags = 0;
    renderer->current = 0;
}

void renderer_change(struct renderer *renderer, const law_parameters *parameters)
{
    renderer->parameters = *parameters;
}

uint32_t renderer_run(struct renderer *renderer, int32_t count, uint32_t index)
{
    const law_input input = {
        .count = count,
        .elapsed_ticks = renderer->begun ? index - renderer->index : 1u,
    };
    const law_output output = law_tick(&renderer->state, &renderer->parameters, &input);
    renderer->begun = true;
    renderer->index = index;
    renderer->current = (int16_t)output.current;
    renderer->flags = output.flags;
    renderer->phase = (uint8_t)output.phase;
    return output.flags & LAW_NONFINITE ? UINT32_C(1) << HR_FAULT_NON_FINITE : 0u;
}
