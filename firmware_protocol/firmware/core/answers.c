#include "answers.h"

#include <string.h>

#include "bytes.h"
#include "law_settings.h"

/* Every transaction begins with its nonce. */
#define AT_NONCE HR_HEADER_BYTES

/* Delay before the reset, so that the reply to ENTER_BOOTLOADER reaches the host: 50 ms. */
#define LEAVES_AFTER (50000u * HR_TIME_UNITS_PER_US)

static uint16_t nonce_of(const uint8_t *raw)
{
    return get_u16(raw + AT_NONCE);
}

/* Copy at most `room` bytes of a long reply, from `offset` on. Returns the number of copied bytes, 0 beyond its end. */
static size_t copy_page(uint8_t *into, const uint8_t *content, size_t total, size_t offset, size_t room)
{
    if (offset >= total)
        return 0;
    const size_t count = total - offset < room ? total - offset : room;
    memcpy(into, content + offset, count);
    return count;
}

/* ------------------------------------------------------------------ requests that only read */

static void send_identity(struct device *device, const uint8_t *request)
{
    struct packet packet;
    const struct board *board = device->board;
    const uint16_t offset = get_u16(request + HR_AT_IDENTIFY_OFFSET);
    uint8_t *raw = connection_begin(&device->connection, &packet, HR_INDEX_IDENTITY, HR_BYTES_IDENTITY);
    put_u16(raw + AT_NONCE, nonce_of(request));
    raw[HR_AT_IDENTITY_MINOR] = HR_MINOR;
    raw[HR_AT_IDENTITY_STATE] = device->connection.state;
    put_u64(raw + HR_AT_IDENTITY_DICTIONARY_HASH, board->dictionary_hash);
    put_u16(raw + HR_AT_IDENTITY_TOTAL, board->dictionary_bytes);
    put_u16(raw + HR_AT_IDENTITY_OFFSET, offset);
    packet.count += copy_page(raw + HR_AT_IDENTITY_DATA, board->dictionary, board->dictionary_bytes, offset,
                              HR_DATA_LIMIT_IDENTITY);
    device_send(device, &packet);
}

static void send_parameters(struct device *device, const uint8_t *request)
{
    struct packet packet;
    const struct configuration *configuration = &device->configuration;
    const uint16_t offset = get_u16(request + HR_AT_GET_PARAMETERS_OFFSET);
    uint8_t *raw = connection_begin(&device->connection, &packet, HR_INDEX_PARAMETERS, HR_BYTES_PARAMETERS);
    put_u16(raw + AT_NONCE, nonce_of(request));
    put_u16(raw + HR_AT_PARAMETERS_TOTAL, sizeof configuration->block);
    put_u32(raw + HR_AT_PARAMETERS_CRC, configuration->crc);
    put_u16(raw + HR_AT_PARAMETERS_OFFSET, offset);
    packet.count += copy_page(raw + HR_AT_PARAMETERS_DATA, configuration->block, sizeof configuration->block, offset,
                              HR_DATA_LIMIT_PARAMETERS);
    device_send(device, &packet);
}

static void send_time(struct device *device, const uint8_t *request)
{
    struct packet packet;
    uint8_t *raw = connection_begin(&device->connection, &packet, HR_INDEX_TIME, HR_BYTES_TIME);
    put_u16(raw + AT_NONCE, nonce_of(request));
    put_u64(raw + HR_AT_TIME_HOST_SENT, get_u64(request + HR_AT_GET_TIME_HOST_SENT));
    put_u64(raw + HR_AT_TIME_DEVICE_RECEIVED, device->received_at);
    put_u64(raw + HR_AT_TIME_DEVICE_SENT, device->hal->time(device->hal->context));
    device_send(device, &packet);
}

static void send_fault_log(struct device *device, const uint8_t *request)
{
    struct packet packet;
    const struct faults *faults = &device->faults;
    const struct fault_ring *ring = faults_log(faults);
    const uint16_t first = get_u16(request + HR_AT_GET_FAULT_LOG_FIRST);
    uint8_t *raw = connection_begin(&device->connection, &packet, HR_INDEX_FAULT_LOG, HR_BYTES_FAULT_LOG);
    put_u16(raw + AT_NONCE, nonce_of(request));
    put_u16(raw + HR_AT_FAULT_LOG_FAULT, faults->first);
    put_u32(raw + HR_AT_FAULT_LOG_LATER, faults->later);
    put_u64(raw + HR_AT_FAULT_LOG_DEVICE_TIME, faults->time);
    put_u16(raw + HR_AT_FAULT_LOG_TOTAL, ring->count);
    put_u16(raw + HR_AT_FAULT_LOG_FIRST, first);
    const size_t room = HR_DATA_LIMIT_FAULT_LOG / HR_FAULT_ENTRY_BYTES;
    for (size_t number = first; number < ring->count && number < first + room; number++) {
        fault_ring_read(ring, (uint16_t)number, raw + packet.count);
        packet.count += HR_FAULT_ENTRY_BYTES;
    }
    device_send(device, &packet);
}

static void send_statistics(struct device *device, const uint8_t *request)
{
    struct packet packet;
    const struct counters *counters = &device->connection.counters;
    uint8_t *raw = connection_begin(&device->connection, &packet, HR_INDEX_STATISTICS, HR_BYTES_STATISTICS);
    put_u16(raw + AT_NONCE, nonce_of(request));
    put_u32(raw + HR_AT_STATISTICS_FRAMES, counters->frames);
    put_u32(raw + HR_AT_STATISTICS_FRAMING_ERRORS, counters->framing_errors);
    put_u32(raw + HR_AT_STATISTICS_CRC_ERRORS, counters->crc_errors);
    put_u32(raw + HR_AT_STATISTICS_MALFORMED, counters->malformed);
    put_u32(raw + HR_AT_STATISTICS_UNKNOWN_TYPE, counters->unknown_type);
    put_u32(raw + HR_AT_STATISTICS_FOREIGN_MAJOR, counters->foreign_major);
    put_u32(raw + HR_AT_STATISTICS_STALE_SESSION, counters->stale_session);
    put_u32(raw + HR_AT_STATISTICS_OUT_OF_STATE, counters->out_of_state);
    put_u32(raw + HR_AT_STATISTICS_LOST, counters->lost);
    put_u32(raw + HR_AT_STATISTICS_DUPLICATED, counters->duplicated);
    put_u32(raw + HR_AT_STATISTICS_REORDERED, counters->reordered);
    put_u32(raw + HR_AT_STATISTICS_STOPPED_AT, device->stopped_at);
    device_send(device, &packet);
}

static void send_reference(struct device *device, const uint8_t *request)
{
    struct packet packet;
    const struct hal *hal = device->hal;
    const struct configuration *configuration = &device->configuration;
    const uint32_t *values = configuration->values;
    int32_t count = 0;
    const uint32_t edges = hal->index_edges != NULL ? hal->index_edges(hal->context, &count) : 0;
    uint8_t *raw = connection_begin(&device->connection, &packet, HR_INDEX_REFERENCE, HR_BYTES_REFERENCE);
    put_u16(raw + AT_NONCE, nonce_of(request));
    raw[HR_AT_REFERENCE_ZERO] = (uint8_t)(configuration->homed ? values[HR_PARAMETER_REFERENCE] + 1u : 0u);
    put_u32(raw + HR_AT_REFERENCE_REFERENCE_COUNT, values[HR_PARAMETER_REFERENCE_COUNT]);
    put_u32(raw + HR_AT_REFERENCE_INDEX_EDGES, edges);
    put_u32(raw + HR_AT_REFERENCE_INDEX_COUNT, (uint32_t)count);
    device_send(device, &packet);
}

/* ------------------------------------------------------------------ requests that change the device */

static struct refusal set_begin(struct device *device, const uint8_t *raw)
{
    const struct refusal result = {
        assembler_begin(&device->assembler, nonce_of(raw), get_u16(raw + HR_AT_SET_BEGIN_LENGTH),
                        get_u32(raw + HR_AT_SET_BEGIN_CRC)),
        0,
    };
    return result;
}

static struct refusal set_chunk(struct device *device, const uint8_t *raw, size_t count)
{
    const uint16_t offset = get_u16(raw + HR_AT_SET_CHUNK_OFFSET);
    const struct refusal result = {
        assembler_chunk(&device->assembler, nonce_of(raw), offset, raw + HR_AT_SET_CHUNK_DATA,
                        count - HR_AT_SET_CHUNK_DATA),
        offset,
    };
    return result;
}

static struct refusal set_while_idle(struct device *device, const struct candidate *candidate, const law_parameters *law)
{
    struct refusal refusal = {HR_STATUS_OK, 0};
    if (!device_apply(device, candidate)) {
        refusal.status = HR_STATUS_INCONSISTENT;
        refusal.detail = hr_parameters[HR_PARAMETER_POSITION_RATE].id;
        return refusal;
    }
    device_take_law(device, law, candidate);
    return refusal;
}

/* Activate a parameter block while the device is not armed. */
static struct refusal set_commit(struct device *device, const uint8_t *raw)
{
    struct candidate candidate;
    law_parameters law;
    struct refusal refusal = {assembler_commit(&device->assembler, nonce_of(raw)), 0};
    if (refusal.status != HR_STATUS_OK)
        return refusal;
    refusal = configuration_read(&device->configuration, device->board, device->assembler.block,
                                 device->assembler.length, &candidate);
    const bool runs_law = candidate.values[HR_PARAMETER_LAW] != LAW_OF_HOST;
    if (refusal.status == HR_STATUS_OK && runs_law)
        refusal = law_settings_read(candidate.values, device->board, device->hal, &law);
    if (refusal.status != HR_STATUS_OK)
        return refusal;
    refusal = set_while_idle(device, &candidate, runs_law ? &law : NULL);
    if (refusal.status == HR_STATUS_OK)
        configuration_activate(&device->configuration, &candidate);
    return refusal;
}

/* Return the fault whose cause is still present and does not disappear at zero effort, or NONE. */
static enum hr_fault present_fault(const struct device *device)
{
    if (device->hal->inputs(device->hal->context) & HR_INPUT_EMERGENCY_STOP)
        return HR_FAULT_EMERGENCY_STOP;
    return thermal_is_overheated(&device->thermal) ? HR_FAULT_THERMAL : HR_FAULT_NONE;
}

static struct refusal objection_to_arm(const struct device *device, const uint8_t *raw)
{
    const struct configuration *configuration = &device->configuration;
    struct refusal refusal = {HR_STATUS_OK, 0};
    if (get_u64(raw + HR_AT_ARM_DICTIONARY_HASH) != device->board->dictionary_hash
        || get_u32(raw + HR_AT_ARM_PARAMETERS_CRC) != configuration->crc)
        refusal.status = HR_STATUS_HASH_MISMATCH;
    else if (!configuration->homed)
        refusal.status = HR_STATUS_NOT_HOMED;
    else if (!configuration->values[HR_PARAMETER_VERIFIED])
        refusal.status = HR_STATUS_NOT_VERIFIED;
    else if (device_is_preparing(device))
        refusal.status = HR_STATUS_NOT_READY;
    if (refusal.status != HR_STATUS_OK)
        return refusal;
    enum hr_fault present = present_fault(device);
    if (present == HR_FAULT_NONE && !monitor_in_window(&device->monitor, device->count))
        present = HR_FAULT_POSITION_WINDOW;
    if (present != HR_FAULT_NONE) {
        refusal.status = HR_STATUS_FAULT_PRESENT;
        refusal.detail = (uint16_t)present;
    } else if (device->hal->amplifier_ready != NULL && !device->hal->amplifier_ready(device->hal->context)) {
        refusal.status = HR_STATUS_NOT_READY;
    }
    return refusal;
}

static struct refusal arm(struct device *device, const uint8_t *raw)
{
    const struct refusal refusal = objection_to_arm(device, raw);
    if (refusal.status != HR_STATUS_OK)
        return refusal;
    device_begin_session(device);
    device_switch_on(device);
    return refusal;
}

static struct refusal disarm(struct device *device)
{
    const bool faulty = device->faults.latched != HR_FAULT_NONE;
    const enum hr_fault present = faulty ? present_fault(device) : HR_FAULT_NONE;
    struct refusal refusal = {HR_STATUS_OK, 0};
    if (present != HR_FAULT_NONE) {
        refusal.status = HR_STATUS_FAULT_PRESENT;
        refusal.detail = (uint16_t)present;
        return refusal;
    }
    device_switch_off(device); /* before packing and sending, which take time */
    device_end_supervision(device);
    faults_clear(&device->faults);
    return refusal;
}

static struct refusal enter_bootloader(struct device *device)
{
    const struct refusal refusal = {device->hal->enter_bootloader != NULL ? HR_STATUS_OK : HR_STATUS_UNSUPPORTED, 0};
    if (refusal.status == HR_STATUS_OK)
        device->leaves_at = device->time + LEAVES_AFTER;
    return refusal;
}

static struct refusal execute(struct device *device, const uint8_t *raw, size_t count)
{
    const struct refusal unsupported = {HR_STATUS_UNSUPPORTED, 0};
    switch (raw[HR_AT_HEADER_TYPE_ID]) {
    case HR_TYPE_SET_BEGIN:
        return set_begin(device, raw);
    case HR_TYPE_SET_CHUNK:
        return set_chunk(device, raw, count);
    case HR_TYPE_SET_COMMIT:
        return set_commit(device, raw);
    case HR_TYPE_ARM:
        return arm(device, raw);
    case HR_TYPE_DISARM:
        return disarm(device);
    case HR_TYPE_ENTER_BOOTLOADER:
        return enter_bootloader(device);
    default:
        return unsupported;
    }
}

/* ------------------------------------------------------------------ acknowledging */

static void send_ack(struct device *device, const struct ack *ack)
{
    struct packet packet;
    uint8_t *raw = connection_begin(&device->connection, &packet, HR_INDEX_ACK, HR_BYTES_ACK);
    put_u16(raw + HR_AT_ACK_NONCE, ack->nonce);
    raw[HR_AT_ACK_REQUEST] = ack->request;
    raw[HR_AT_ACK_STATUS] = ack->status;
    put_u16(raw + HR_AT_ACK_DETAIL, ack->detail);
    put_u32(raw + HR_AT_ACK_SAMPLE_INDEX, ack->sample_index);
    put_u32(raw + HR_AT_ACK_CRC, ack->crc);
    device_send(device, &packet);
}

/* Execute a request and return its ACK, with the first tick that uses the change and the CRC of the parameters. */
static struct ack execute_and_report(struct device *device, const uint8_t *raw, size_t count)
{
    const uint8_t type = raw[HR_AT_HEADER_TYPE_ID];
    const struct refusal refusal = execute(device, raw, count);
    const bool has_crc = type == HR_TYPE_SET_COMMIT || type == HR_TYPE_ARM;
    const struct ack ack = {
        .nonce = nonce_of(raw),
        .request = type,
        .status = (uint8_t)refusal.status,
        .detail = refusal.detail,
        .sample_index = device->sample_index + 1u,
        .crc = has_crc ? device->configuration.crc : 0u,
    };
    return ack;
}

static struct ack make_refusal(const uint8_t *raw, const struct verdict *verdict)
{
    const struct ack ack = {
        .nonce = nonce_of(raw),
        .request = raw[HR_AT_HEADER_TYPE_ID],
        .status = (uint8_t)verdict->status,
        .detail = verdict->detail,
    };
    return ack;
}

static bool is_remembered_type(uint8_t type)
{
    for (size_t i = 0; i < HR_MESSAGES; i++)
        if (hr_messages[i].type == type)
            return hr_messages[i].remembered != 0;
    return false;
}

static bool is_repeat(const struct remembered *last, const uint8_t *raw)
{
    return last->there && last->ack.request == raw[HR_AT_HEADER_TYPE_ID] && last->ack.nonce == nonce_of(raw)
           && last->session == raw[HR_AT_HEADER_SESSION];
}

static void remember(struct device *device, const struct ack *ack, uint8_t session)
{
    device->remembered.there = true;
    device->remembered.session = session;
    device->remembered.ack = *ack;
}

/* A repeated request is not executed again: a late DISARM must not clear a fault that was latched after the first. */
static void acknowledge(struct device *device, const uint8_t *raw, size_t count, const struct verdict *verdict)
{
    const uint8_t type = raw[HR_AT_HEADER_TYPE_ID], session = raw[HR_AT_HEADER_SESSION];
    const bool remembers = is_remembered_type(type);
    if (remembers && is_repeat(&device->remembered, raw)) {
        send_ack(device, &device->remembered.ack);
        return;
    }
    if (verdict->kind == VERDICT_REQUEST && type == HR_TYPE_SET_COMMIT && device_is_armed(device)) {
        live_change_begin(&device->live_change, &device->assembler, nonce_of(raw), session); /* answered when done */
        return;
    }
    const struct ack ack = verdict->kind == VERDICT_REFUSE ? make_refusal(raw, verdict) : execute_and_report(device, raw, count);
    if (remembers)
        remember(device, &ack, session);
    send_ack(device, &ack);
    if (verdict->kind == VERDICT_REQUEST && ack.status == HR_STATUS_OK)
        connection_advance(&device->connection, type, session);
}

static void answer_live_change(struct device *device)
{
    const struct live_change *change = &device->live_change;
    const bool done = change->refusal.status == HR_STATUS_OK;
    const struct ack ack = {
        .nonce = change->nonce,
        .request = HR_TYPE_SET_COMMIT,
        .status = (uint8_t)change->refusal.status,
        .detail = change->refusal.detail,
        .sample_index = done ? change->sample_index : device->sample_index + 1u,
        .crc = device->configuration.crc,
    };
    remember(device, &ack, change->session);
    send_ack(device, &ack);
}

void answer_more(struct device *device)
{
    const struct live_change_of of = {
        .board = device->board,
        .hal = device->hal,
        .assembler = &device->assembler,
        .configuration = &device->configuration,
        .renderer = &device->renderer,
        .sample_index = device->sample_index,
        .count = device->count,
        .state = device->connection.state,
        .armed = device_is_armed(device),
    };
    if (live_change_continue(&device->live_change, &of))
        answer_live_change(device);
}

/* Send the reply to a request that only reads; false for every other request. */
static bool send_reply(struct device *device, const uint8_t *raw)
{
    switch (raw[HR_AT_HEADER_TYPE_ID]) {
    case HR_TYPE_IDENTIFY:
        send_identity(device, raw);
        return true;
    case HR_TYPE_GET_PARAMETERS:
        send_parameters(device, raw);
        return true;
    case HR_TYPE_GET_TIME:
        send_time(device, raw);
        return true;
    case HR_TYPE_GET_FAULT_LOG:
        send_fault_log(device, raw);
        return true;
    case HR_TYPE_GET_STATISTICS:
        send_statistics(device, raw);
        return true;
    case HR_TYPE_GET_REFERENCE:
        send_reference(device, raw);
        return true;
    default:
        return false;
    }
}

/* One request at a time: only if the host does not wait for a reply does this poll take longer. */
void answer(struct device *device, const uint8_t *raw, size_t count, const struct verdict *verdict)
{
    while (device_is_changing(device))
        answer_more(device);
    if (verdict->kind == VERDICT_REQUEST && send_reply(device, raw))
        connection_advance(&device->connection, raw[HR_AT_HEADER_TYPE_ID], raw[HR_AT_HEADER_SESSION]);
    else
        acknowledge(device, raw, count, verdict);
}
