/* Anything at all into the core, under the sanitizers: fuzz SEED STEPS. Deterministic; prints what it reached.
 *
 * Frames with a good CRC and any content, frames with flipped bits, noise; ticks with any count and measurement
 * in between. What must hold whatever comes: no current unless armed, never above current_limit, none behind a
 * latched fault. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host.h"

#define NARROWED_LIMIT 5000u
#define CHECK(condition)                                                                                    \
    do {                                                                                                    \
        if (!(condition)) {                                                                                 \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);                                 \
            exit(1);                                                                                        \
        }                                                                                                   \
    } while (0)

static uint64_t state_of_chance;

/* splitmix64 */
static uint64_t chance(void)
{
    uint64_t z = state_of_chance += UINT64_C(0x9E3779B97F4A7C15);
    z = (z ^ z >> 30) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ z >> 27) * UINT64_C(0x94D049BB133111EB);
    return z ^ z >> 31;
}

static uint32_t below(uint32_t end)
{
    return (uint32_t)(chance() % end);
}

static void put(uint8_t *at, size_t bytes, uint64_t value)
{
    for (size_t i = 0; i < bytes; i++)
        at[i] = (uint8_t)(value >> 8 * i & 0xFFu);
}

struct fuzz {
    struct host *host;
    uint16_t nonce;
    uint16_t sequence;
    uint32_t states[HR_STATES];
    uint32_t faults[16];
};

static void send(struct fuzz *fuzz, struct packet *packet, bool damage)
{
    size_t count = frame_finish(packet);
    if (damage)
        packet->bytes[below((uint32_t)count)] ^= (uint8_t)(1u << below(8));
    host_receive(fuzz->host, packet->bytes, count);
}

static uint8_t *begin(const struct fuzz *fuzz, struct packet *packet, uint8_t type, size_t count)
{
    uint8_t *raw = packet->bytes + HR_RAW_AT;
    packet->count = count;
    raw[HR_AT_HEADER_MAJOR] = HR_MAJOR;
    raw[HR_AT_HEADER_TYPE_ID] = type;
    raw[HR_AT_HEADER_FLAGS] = 0;
    raw[HR_AT_HEADER_SESSION] = fuzz->host->device.connection.session;
    put(raw + HR_AT_HEADER_SEQUENCE, 2, fuzz->sequence);
    put(raw + HR_HEADER_BYTES, 2, fuzz->nonce);
    return raw;
}

/* A known type of the right length or a wrong one, or an unknown type; then any bytes. */
static void send_any(struct fuzz *fuzz)
{
    struct packet packet;
    const struct hr_message *message = &hr_messages[below(HR_MESSAGES)];
    const uint8_t type = below(8) ? message->type : (uint8_t)below(256);
    const size_t longest = HR_SHORT_RAW_LIMIT - HR_CRC_BYTES;
    const bool fits = below(4) != 0 && message->bytes <= longest;
    const size_t any = HR_HEADER_BYTES + below((uint32_t)longest - HR_HEADER_BYTES + 1);
    uint8_t *raw = begin(fuzz, &packet, type, longest);
    for (size_t i = HR_HEADER_BYTES + 2; i < longest; i++)
        raw[i] = below(3) ? (uint8_t)below(256) : 0;
    if (!below(4))
        raw[HR_AT_HEADER_SESSION] = (uint8_t)below(3);
    packet.count = fits ? message->bytes : any;
    send(fuzz, &packet, !below(6));
}

static void identify(struct fuzz *fuzz)
{
    struct packet packet;
    uint8_t *raw = begin(fuzz, &packet, HR_TYPE_IDENTIFY, HR_BYTES_IDENTIFY);
    put(raw + HR_AT_IDENTIFY_OFFSET, 2, below(300));
    send(fuzz, &packet, false);
}

/* A block of every parameter, most values inside their ranges. */
static size_t make_block(uint8_t *block)
{
    const uint32_t speeds[] = {0, 1000, UINT32_MAX};
    size_t count = 0;
    for (size_t i = 0; i < HR_PARAMETERS; i++) {
        const struct hr_parameter *parameter = &hr_parameters[i];
        uint32_t value = below(3) ? parameter->initial : below(2) ? parameter->minimum : parameter->maximum;
        if (i == HR_PARAMETER_VERIFIED)
            value = 1;
        if (i == HR_PARAMETER_MOTION)
            value = 0;
        if (i == HR_PARAMETER_CURRENT_LIMIT || i == HR_PARAMETER_CONTINUOUS_CURRENT)
            value = below(NARROWED_LIMIT + 1);
        if (i == HR_PARAMETER_WINDOW_MINIMUM)
            value = (uint32_t)(below(4) ? INT32_MIN : -50);
        if (i == HR_PARAMETER_WINDOW_MAXIMUM)
            value = INT32_MAX;
        if (i == HR_PARAMETER_SPEED_LIMIT)
            value = speeds[below(3)];
        if (!below(40))
            value = (uint32_t)chance();
        put(block + count, 2, parameter->id);
        put(block + count + 2, 4, value);
        count += HR_PARAMETER_BYTES;
    }
    return count;
}

static void configure(struct fuzz *fuzz)
{
    struct packet packet;
    uint8_t block[HR_FULL_BLOCK_BYTES];
    const size_t count = make_block(block);
    fuzz->nonce++;
    uint8_t *raw = begin(fuzz, &packet, HR_TYPE_SET_BEGIN, HR_BYTES_SET_BEGIN);
    put(raw + HR_AT_SET_BEGIN_LENGTH, 2, count);
    put(raw + HR_AT_SET_BEGIN_CRC, 4, crc_of(block, count));
    send(fuzz, &packet, false);
    for (size_t at = 0; at < count; at += HR_DATA_LIMIT_SET_CHUNK) {
        const size_t piece = count - at < HR_DATA_LIMIT_SET_CHUNK ? count - at : HR_DATA_LIMIT_SET_CHUNK;
        raw = begin(fuzz, &packet, HR_TYPE_SET_CHUNK, HR_BYTES_SET_CHUNK + piece);
        put(raw + HR_AT_SET_CHUNK_OFFSET, 2, at);
        memcpy(raw + HR_AT_SET_CHUNK_DATA, block + at, piece);
        send(fuzz, &packet, !below(50));
    }
    begin(fuzz, &packet, HR_TYPE_SET_COMMIT, HR_BYTES_SET_COMMIT);
    send(fuzz, &packet, false);
}

static void arm(struct fuzz *fuzz)
{
    struct packet packet;
    uint8_t *raw = begin(fuzz, &packet, HR_TYPE_ARM, HR_BYTES_ARM);
    put(raw + HR_AT_ARM_DICTIONARY_HASH, 8, fuzz->host->board.dictionary_hash);
    put(raw + HR_AT_ARM_PARAMETERS_CRC, 4, fuzz->host->device.configuration.crc);
    raw[HR_AT_HEADER_SESSION] = (uint8_t)below(256);
    fuzz->sequence = 0;
    send(fuzz, &packet, false);
}

static void disarm(struct fuzz *fuzz)
{
    struct packet packet;
    uint8_t *raw = begin(fuzz, &packet, HR_TYPE_DISARM, HR_BYTES_DISARM);
    raw[HR_AT_DISARM_FLAGS] = (uint8_t)below(2);
    fuzz->nonce++;
    send(fuzz, &packet, false);
}

static void command(struct fuzz *fuzz)
{
    struct packet packet;
    uint8_t *raw = begin(fuzz, &packet, HR_TYPE_COMMAND, HR_BYTES_COMMAND);
    put(raw + HR_AT_COMMAND_LIFETIME_US, 4, below(2) ? 20000u : chance());
    raw[HR_AT_COMMAND_MODE] = (uint8_t)(below(8) ? 0 : below(256));
    raw[HR_AT_COMMAND_FLAGS] = 0;
    put(raw + HR_AT_COMMAND_CURRENT, 2, chance());
    fuzz->sequence++;
    send(fuzz, &packet, !below(30));
}

static void noise(struct fuzz *fuzz)
{
    uint8_t bytes[300];
    const size_t count = below(sizeof bytes);
    for (size_t i = 0; i < count; i++)
        bytes[i] = (uint8_t)below(256);
    host_receive(fuzz->host, bytes, count);
}

static void check(struct fuzz *fuzz)
{
    const struct device *device = &fuzz->host->device;
    const uint8_t state = device->connection.state;
    const int32_t limit = (int32_t)device->configuration.values[HR_PARAMETER_CURRENT_LIMIT];
    CHECK(state < HR_STATES);
    CHECK(abs(fuzz->host->current) <= limit);
    CHECK(limit <= (int32_t)NARROWED_LIMIT);
    if (state != HR_STATE_ARMED && state != HR_STATE_RUNNING) {
        CHECK(fuzz->host->current == 0);
        CHECK(!fuzz->host->enabled);
    }
    CHECK((state == HR_STATE_FAULT) == (device->faults.latched != HR_FAULT_NONE));
    fuzz->states[state]++;
    fuzz->faults[device->faults.latched]++;
}

static void tick(struct fuzz *fuzz)
{
    struct host *host = fuzz->host;
    uint8_t away[256];
    int32_t count = host->count + (int32_t)below(5) - 2;
    if (!below(300))
        count = below(10) ? (int32_t)below(200) - 100 : (int32_t)(chance() >> 33) - (1 << 30);
    const uint8_t inputs = (uint8_t)(below(500) ? HR_INPUT_HOLD_TO_RUN : below(256));
    const int16_t measured = (int16_t)(below(3000) ? host->current : (int32_t)below(65536) - 32768);
    const uint64_t late = below(100) ? 0 : below(1000000);
    host_set_world(host, host->device.due + late, count, below(2) ? host->time : 0, measured, inputs);
    host_set_clock(host, host->time, below(2000) ? 0 : below(20000));
    if (!below(5000))
        host_fail_encoder(host);
    host_tick(host);
    if (!below(5000))
        host_missed(host, below(100));
    while (host_take(host, away, sizeof away) > 0) {
    }
}

/* Those that nothing in a simulated world can cause. */
static void inject(struct fuzz *fuzz)
{
    const uint8_t faults[] = {HR_FAULT_NON_FINITE, HR_FAULT_WATCHDOG_RESET, HR_FAULT_INTERNAL, HR_FAULT_BATCH_OVERFLOW};
    host_fault(fuzz->host, faults[below(sizeof faults)]);
}

static void step(struct fuzz *fuzz)
{
    const uint32_t which = below(1000);
    if (which < 2)
        noise(fuzz);
    else if (which < 4)
        inject(fuzz);
    else if (which < 7)
        host_restart(fuzz->host);
    else if (which < 40)
        send_any(fuzz);
    else if (which < 50)
        identify(fuzz);
    else if (which < 70)
        configure(fuzz);
    else if (which < 100)
        arm(fuzz);
    else if (which < 115)
        disarm(fuzz);
    else if (which < 600)
        command(fuzz);
    else
        tick(fuzz);
}

int main(int count, char **arguments)
{
    static const uint8_t dictionary[] = "not a dictionary, and nobody minds";
    const struct host_setup setup = {
        .dictionary = dictionary,
        .dictionary_hash = 7,
        .dictionary_bytes = sizeof dictionary,
        .rate_initial = 1000,
        .encoder_sign = 1,
        .over_current = 5500,
        .mechanics = {1e-4, 1.0, 2e-3, 6e-4, 1e-3, 0.0, 0.0},
    };
    struct fuzz fuzz = {.host = calloc(1, host_bytes())};
    CHECK(count == 3 && fuzz.host != NULL);
    state_of_chance = strtoull(arguments[1], NULL, 10);
    host_setup(fuzz.host, &setup);
    host_narrow(fuzz.host, HR_PARAMETER_CURRENT_LIMIT, 0, NARROWED_LIMIT);
    host_narrow(fuzz.host, HR_PARAMETER_CONTINUOUS_CURRENT, 0, NARROWED_LIMIT);
    host_start(fuzz.host);
    for (unsigned long left = strtoul(arguments[2], NULL, 10); left > 0; left--) {
        step(&fuzz);
        check(&fuzz);
    }
    for (size_t i = 0; i < HR_STATES; i++)
        printf("state %zu %u\n", i, fuzz.states[i]);
    for (size_t i = 0; i < sizeof fuzz.faults / sizeof fuzz.faults[0]; i++)
        printf("fault %zu %u\n", i, fuzz.faults[i]);
    free(fuzz.host);
    return 0;
}
