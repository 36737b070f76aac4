#include "live_change.h"

#include "frame.h"
#include "law_settings.h"

/* Size of a step: about 1000 cycles of a Cortex-M0+. */
enum { SUM_BYTES = 48, ENTRIES = 2, CRC_VALUES = 6, VALUES = 14 };

static void enter_step(struct live_change *change, enum live_step step)
{
    change->step = (uint8_t)(change->refusal.status == HR_STATUS_OK ? step : LIVE_DONE);
    change->at = 0;
}

void live_change_begin(struct live_change *change, struct assembler *assembler, uint16_t nonce, uint8_t session)
{
    change->nonce = nonce;
    change->session = session;
    change->refusal.status = assembler_close(assembler, nonce);
    change->refusal.detail = 0;
    change->crc = UINT32_MAX;
    enter_step(change, LIVE_SUM);
}

static void sum_up_block(struct live_change *change, const struct live_change_of *of)
{
    const struct assembler *assembler = of->assembler;
    const uint16_t left = (uint16_t)(assembler->length - change->at);
    const uint16_t bytes = left < SUM_BYTES ? left : SUM_BYTES;
    change->crc = crc_more(change->crc, assembler->block + change->at, bytes);
    change->at = (uint16_t)(change->at + bytes);
    if (change->at < assembler->length)
        return;
    if (~change->crc != assembler->crc)
        change->refusal.status = HR_STATUS_BAD_CRC;
    else if (assembler->length % HR_PARAMETER_BYTES != 0)
        change->refusal.status = HR_STATUS_BAD_LENGTH;
    configuration_begin(of->configuration, &change->candidate);
    enter_step(change, LIVE_ENTRIES);
}

static void read_entries(struct live_change *change, const struct live_change_of *of)
{
    const struct assembler *assembler = of->assembler;
    for (unsigned i = 0; i < ENTRIES && change->at < assembler->length && change->refusal.status == HR_STATUS_OK; i++) {
        change->refusal = configuration_take(&change->candidate, assembler->block + change->at);
        change->at = (uint16_t)(change->at + HR_PARAMETER_BYTES);
    }
    if (change->at >= assembler->length || change->refusal.status != HR_STATUS_OK)
        enter_step(change, LIVE_CHECK);
}

static void read_law(struct live_change *change, const struct live_change_of *of)
{
    if (of->renderer->there) {
        change->law = of->renderer->parameters;
        change->refusal = law_settings_read_wall(change->candidate.values, of->hal, &change->law);
    }
    change->crc = UINT32_MAX;
    enter_step(change, LIVE_CRC);
}

static void sum_up(struct live_change *change)
{
    uint8_t entry[HR_PARAMETER_BYTES];
    for (unsigned i = 0; i < CRC_VALUES && change->at < HR_PARAMETERS; i++) {
        configuration_entry(change->candidate.values, change->at++, entry);
        change->crc = crc_more(change->crc, entry, sizeof entry);
    }
    if (change->at == HR_PARAMETERS) {
        change->crc = ~change->crc;
        enter_step(change, LIVE_WALL);
    }
}

/* A wall changes in free space alone: a jump of stiffness under a pressed hand would be a jump of effort. A bilateral
 * wall has no free space. After a fault since the request nothing is changed. */
static void change_wall(struct live_change *change, const struct live_change_of *of)
{
    struct renderer *renderer = of->renderer;
    change->sample_index = of->sample_index + 1u;
    if (!of->armed) {
        change->refusal.status = HR_STATUS_BAD_STATE;
        change->refusal.detail = of->state;
    } else if (renderer->there
               && !(law_is_free(&renderer->parameters, of->count) && law_is_free(&change->law, of->count))) {
        change->refusal.status = HR_STATUS_INSIDE_WALL;
    } else if (renderer->there) {
        renderer_change(renderer, &change->law);
    }
    enter_step(change, LIVE_VALUES);
}

static void put_values(struct live_change *change, const struct live_change_of *of)
{
    for (unsigned i = 0; i < VALUES && change->at < HR_PARAMETERS; i++)
        configuration_put(of->configuration, &change->candidate, change->at++);
    if (change->at == HR_PARAMETERS) {
        of->configuration->crc = change->crc;
        enter_step(change, LIVE_DONE);
    }
}

bool live_change_continue(struct live_change *change, const struct live_change_of *of)
{
    switch ((enum live_step)change->step) {
    case LIVE_SUM:
        sum_up_block(change, of);
        break;
    case LIVE_ENTRIES:
        read_entries(change, of);
        break;
    case LIVE_CHECK:
        change->refusal = configuration_check(&change->candidate, of->board, true);
        enter_step(change, LIVE_LAW);
        break;
    case LIVE_LAW:
        read_law(change, of);
        break;
    case LIVE_CRC:
        sum_up(change);
        break;
    case LIVE_WALL:
        change_wall(change, of);
        break;
    case LIVE_VALUES:
        put_values(change, of);
        break;
    case LIVE_DONE:
        change->step = LIVE_NOTHING;
        return true;
    case LIVE_NOTHING:
        break;
    }
    return false;
}
