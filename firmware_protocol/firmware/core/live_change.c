#include "live_change.h"

#include "device_internal.h"
#include "law_settings.h"

/* A piece: what a Cortex-M0+ does in some 1000 cycles. */
enum { SUM_BYTES = 48, ENTRIES = 2, CRC_VALUES = 6, VALUES = 14 };

static void go_on(struct live_change *change, enum live_step step)
{
    change->step = (uint8_t)(change->refusal.status == HR_STATUS_OK ? step : LIVE_ANSWER);
    change->at = 0;
}

void live_change_begin(struct device *device, uint16_t nonce, uint8_t session)
{
    struct live_change *change = &device->live_change;
    change->nonce = nonce;
    change->session = session;
    change->refusal.status = assembler_close(&device->assembler, nonce);
    change->refusal.detail = 0;
    change->crc = UINT32_MAX;
    go_on(change, LIVE_SUM);
}

static void sum_up_block(struct device *device)
{
    struct live_change *change = &device->live_change;
    const struct assembler *assembler = &device->assembler;
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
    configuration_begin(&device->configuration, &change->candidate);
    go_on(change, LIVE_ENTRIES);
}

static void read_entries(struct device *device)
{
    struct live_change *change = &device->live_change;
    const struct assembler *assembler = &device->assembler;
    for (unsigned i = 0; i < ENTRIES && change->at < assembler->length && change->refusal.status == HR_STATUS_OK; i++) {
        change->refusal = configuration_take(&change->candidate, assembler->block + change->at);
        change->at = (uint16_t)(change->at + HR_PARAMETER_BYTES);
    }
    if (change->at >= assembler->length || change->refusal.status != HR_STATUS_OK)
        go_on(change, LIVE_CHECK);
}

static void read_law(struct device *device)
{
    struct live_change *change = &device->live_change;
    if (device->renderer.there) {
        change->law = device->renderer.parameters;
        change->refusal = law_settings_read_wall(change->candidate.values, &change->law);
    }
    change->crc = UINT32_MAX;
    go_on(change, LIVE_CRC);
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
        go_on(change, LIVE_WALL);
    }
}

/* A wall changes in free space alone: a jump of stiffness under a pressed hand would be a jump of effort. A bilateral
 * wall leaves no space free. A fault may have come since the request, and then nothing changes any more. */
static void change_wall(struct device *device)
{
    struct live_change *change = &device->live_change;
    struct renderer *renderer = &device->renderer;
    if (!device_is_armed(device)) {
        change->refusal.status = HR_STATUS_BAD_STATE;
        change->refusal.detail = device->connection.state;
    } else if (renderer->there
               && !(law_is_free(&renderer->parameters, device->count) && law_is_free(&change->law, device->count))) {
        change->refusal.status = HR_STATUS_INSIDE_WALL;
    } else if (renderer->there) {
        renderer_change(renderer, &change->law);
    }
    go_on(change, LIVE_VALUES);
}

static void put_values(struct device *device)
{
    struct live_change *change = &device->live_change;
    for (unsigned i = 0; i < VALUES && change->at < HR_PARAMETERS; i++)
        configuration_put(&device->configuration, &change->candidate, change->at++);
    if (change->at == HR_PARAMETERS) {
        device->configuration.crc = change->crc;
        go_on(change, LIVE_ANSWER);
    }
}

void live_change_continue(struct device *device)
{
    struct live_change *change = &device->live_change;
    switch ((enum live_step)change->step) {
    case LIVE_SUM:
        sum_up_block(device);
        break;
    case LIVE_ENTRIES:
        read_entries(device);
        break;
    case LIVE_CHECK:
        change->refusal = configuration_check(&change->candidate, device->board, true);
        go_on(change, LIVE_LAW);
        break;
    case LIVE_LAW:
        read_law(device);
        break;
    case LIVE_CRC:
        sum_up(change);
        break;
    case LIVE_WALL:
        change->sample_index = device->sample_index + 1u;
        change_wall(device);
        break;
    case LIVE_VALUES:
        put_values(device);
        break;
    case LIVE_ANSWER:
        change->step = LIVE_NOTHING;
        answer_live_change(device);
        break;
    case LIVE_NOTHING:
        break;
    }
}
