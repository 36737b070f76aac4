#include "connection.h"

#include <string.h>

#include "bytes.h"

static const struct verdict DROP = {VERDICT_DROP, HR_STATUS_OK, 0};

static enum hr_index index_of(uint8_t type)
{
    size_t index = 0;
    while (index < HR_MESSAGES && hr_messages[index].type != type)
        index++;
    return (enum hr_index)index;
}

static void open_session(struct connection *connection, uint8_t session)
{
    connection->session = session;
    if (session != 0)
        connection->last_session = session;
    connection->has_command = false;
    connection->to_send[HR_INDEX_STATE] = 0;
    connection->to_send[HR_INDEX_BATCH] = 0;
}

static void move(struct connection *connection, uint8_t after)
{
    if (connection->session != 0 && after < HR_STATE_ARMED)
        open_session(connection, 0);
    connection->state = after;
}

void connection_reset(struct connection *connection)
{
    connection->state = HR_STATE_BOOT;
    open_session(connection, 0);
    connection->last_session = 0;
    memset(connection->to_send, 0, sizeof connection->to_send);
    splitter_reset(&connection->splitter);
}

/* A refusal needs a nonce to name; a stream is never answered. */
static struct verdict refuse(const uint8_t *raw, size_t count, enum hr_status status, uint16_t detail)
{
    struct verdict verdict = {VERDICT_REFUSE, status, detail};
    if (raw[HR_AT_HEADER_TYPE_ID] >= HR_TRANSACTION_END || count < HR_HEADER_BYTES + 2u)
        verdict.kind = VERDICT_DROP;
    return verdict;
}

/* Count the COMMANDs lost since the newest one; return true if this one is newer. */
static bool is_news(struct connection *connection, uint16_t sequence)
{
    const uint16_t step = connection->has_command ? (uint16_t)(sequence - connection->newest) : 1u;
    if (step == 0) {
        connection->counters.duplicated++;
        return false;
    }
    if (step > INT16_MAX) { /* sequences wrap: the older half of them is reordered */
        connection->counters.reordered++;
        return false;
    }
    connection->counters.lost += step - 1u;
    connection->has_command = true;
    connection->newest = sequence;
    return true;
}

static struct verdict judge_command(struct connection *connection, const uint8_t *raw, size_t count)
{
    const struct verdict deliver = {VERDICT_COMMAND, HR_STATUS_OK, 0};
    const uint8_t after = hr_transitions[connection->state][HR_INDEX_COMMAND];
    if (raw[HR_AT_HEADER_SESSION] != connection->session) {
        connection->counters.stale_session++;
        return DROP;
    }
    if (after == HR_NO_TRANSITION) {
        connection->counters.out_of_state++;
        return DROP;
    }
    if (count < HR_BYTES_COMMAND || count > hr_messages[HR_INDEX_COMMAND].limit) {
        connection->counters.malformed++;
        return DROP;
    }
    if (!is_news(connection, get_u16(raw + HR_AT_HEADER_SEQUENCE)))
        return DROP;
    move(connection, after);
    return deliver;
}

/* Return the reason why the state, or a rule beside the table, forbids a request; OK if none does. */
static struct verdict objection(const struct connection *connection, enum hr_index index, const uint8_t *raw)
{
    const uint8_t session = raw[HR_AT_HEADER_SESSION];
    struct verdict verdict = {VERDICT_REFUSE, HR_STATUS_OK, 0};
    if (hr_transitions[connection->state][index] == HR_NO_TRANSITION) {
        verdict.status = HR_STATUS_BAD_STATE;
        verdict.detail = connection->state;
    } else if (index == HR_INDEX_ARM && (session == 0 || session == connection->last_session)) {
        verdict.status = HR_STATUS_STALE_SESSION;
        verdict.detail = session;
    } else if (connection->state == HR_STATE_FAULT && index == HR_INDEX_DISARM
               && !(raw[HR_AT_DISARM_FLAGS] & HR_DISARM_CLEAR_FAULT)) {
        verdict.status = HR_STATUS_FAULT_LATCHED;
    }
    return verdict;
}

static struct verdict judge_request(struct connection *connection, enum hr_index index, const uint8_t *raw,
                                    size_t count)
{
    const struct hr_message *message = &hr_messages[index];
    const struct verdict execute = {VERDICT_REQUEST, HR_STATUS_OK, 0};
    if (count < message->bytes || count > message->limit) {
        connection->counters.malformed++;
        return refuse(raw, count, HR_STATUS_BAD_LENGTH, 0);
    }
    const struct verdict against = objection(connection, index, raw);
    if (against.status != HR_STATUS_OK) {
        connection->counters.out_of_state++;
        return against;
    }
    return execute;
}

struct verdict connection_judge(struct connection *connection, const uint8_t *raw, size_t count)
{
    const uint8_t type = raw[HR_AT_HEADER_TYPE_ID];
    if (raw[HR_AT_HEADER_MAJOR] != HR_MAJOR && type != HR_TYPE_IDENTIFY) {
        connection->counters.foreign_major++;
        return DROP;
    }
    if (type & HR_DEVICE_BIT) {
        connection->counters.wrong_direction++;
        return DROP;
    }
    const enum hr_index index = index_of(type);
    if (index == HR_MESSAGES) {
        connection->counters.unknown_type++;
        return refuse(raw, count, HR_STATUS_UNSUPPORTED, 0);
    }
    if (index == HR_INDEX_COMMAND)
        return judge_command(connection, raw, count);
    return judge_request(connection, index, raw, count);
}

void connection_advance(struct connection *connection, uint8_t type, uint8_t session)
{
    if (type == HR_TYPE_ARM)
        open_session(connection, session);
    move(connection, hr_transitions[connection->state][index_of(type)]);
}

void connection_fault(struct connection *connection)
{
    connection->state = HR_STATE_FAULT;
}

void connection_header(struct connection *connection, uint8_t *raw, enum hr_index index)
{
    raw[HR_AT_HEADER_MAJOR] = HR_MAJOR;
    raw[HR_AT_HEADER_TYPE_ID] = hr_messages[index].type;
    raw[HR_AT_HEADER_FLAGS] = 0;
    raw[HR_AT_HEADER_SESSION] = connection->session;
    put_u16(raw + HR_AT_HEADER_SEQUENCE, connection->to_send[index]);
    connection_skip(connection, index);
}

uint8_t *connection_begin(struct connection *connection, struct packet *packet, enum hr_index index, size_t bytes)
{
    uint8_t *raw = packet->bytes + HR_RAW_AT;
    packet->count = bytes;
    connection_header(connection, raw, index);
    return raw;
}

void connection_skip(struct connection *connection, enum hr_index index)
{
    connection->to_send[index]++;
}
