/* Anything at all into the core, under the sanitizers: fuzz SEED STEPS. Deterministic; prints what it reached.
 *
 * Frames with a good CRC and any content, frames with flipped bits, noise; laws of any kind that the device runs; ticks
 * with any count and measurement in between. What must hold whatever comes: no current unless armed, never above
 * current_limit, none behind a latched fault, none after a silence; armed only by a valid ARM; a fault leaves only when
 * it is cleared; and whatever leaves is a whole frame. */
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
    struct splitter output; /* of what the device sends */
    struct counters broken;
    uint32_t states[HR_STATES];
    uint32_t faults[32];
    uint32_t laws[3];   /* ticks under supervision */
    uint32_t phases[LAW_FREE + 1]; /* of the law */
    uint32_t batches[3]; /* frames of each layout */
    uint32_t lives;     /* walls that changed while the device was armed */
    uint64_t bytes;     /* into the device */
    uint32_t ticks, ticks_armed, silences;
    bool may_arm, may_clear; /* in this step */
    uint8_t state, latched;  /* after the last */
};

static bool is_lively(const struct fuzz *fuzz)
{
    const uint8_t state = fuzz->host->device.connection.state;
    return state == HR_STATE_ARMED || state == HR_STATE_RUNNING;
}

static void receive(struct fuzz *fuzz, const uint8_t *bytes, size_t count)
{
    fuzz->bytes += count;
    host_receive(fuzz->host, bytes, count);
}

static void send(struct fuzz *fuzz, struct packet *packet, bool damage)
{
    size_t count = frame_finish(packet);
    if (damage)
        packet->bytes[below((uint32_t)count)] ^= (uint8_t)(1u << below(8));
    receive(fuzz, packet->bytes, count);
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
    fuzz->may_clear = type == HR_TYPE_DISARM && (raw[HR_AT_DISARM_FLAGS] & 1u);
    send(fuzz, &packet, !below(6));
}

static void identify(struct fuzz *fuzz)
{
    struct packet packet;
    uint8_t *raw = begin(fuzz, &packet, HR_TYPE_IDENTIFY, HR_BYTES_IDENTIFY);
    put(raw + HR_AT_IDENTIFY_OFFSET, 2, below(300));
    send(fuzz, &packet, false);
}

static uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* A number of a law, of a size that a law may have. */
static uint32_t any_number(const struct hr_parameter *parameter)
{
    const int32_t whole = (int32_t)below(2000) - (parameter->minimum == 0 ? 0 : 1000);
    if (parameter->kind == HR_FLOAT)
        return bits_of((float)whole * (below(2) ? 1.0f : 0.001f));
    return (uint32_t)whole;
}

/* A value for a law that has a good chance of being one. */
static uint32_t law_value(size_t index, uint32_t law)
{
    const struct hr_parameter *parameter = &hr_parameters[index];
    switch (index) {
    case HR_PARAMETER_LAW:
        return law;
    case HR_PARAMETER_BATCH_LAYOUT:
        return below(3);
    case HR_PARAMETER_BATCH_SAMPLES:
        return 1 + below(76);
    case HR_PARAMETER_ESTIMATOR:
        return law == 2 ? below(7) : 0;
    case HR_PARAMETER_VELOCITY_DIVIDER:
        return below(3) ? 1 : 1 + below(1000);
    case HR_PARAMETER_WALL_SIDE:
        return below(2) ? 1 : UINT32_MAX;
    case HR_PARAMETER_EXTRAPOLATE:
        return law == 2 ? below(2) : 0;
    case HR_PARAMETER_SLOW_MULTIPLE:
        return 1 + below(3);
    case HR_PARAMETER_TRIAL_TICKS:
    case HR_PARAMETER_RELEASE_TICKS:
    case HR_PARAMETER_SETTLE_TICKS:
        return 1 + below(30);
    case HR_PARAMETER_FREE_TICKS:
    case HR_PARAMETER_HOLD_TICKS:
        return below(2) ? 0 : 1 + below(30);
    case HR_PARAMETER_HOME_TIMEOUT_TICKS:
        return below(8) ? UINT32_MAX : below(20);
    case HR_PARAMETER_LAW_WINDOW_MINIMUM:
    case HR_PARAMETER_HOME_MINIMUM:
    case HR_PARAMETER_FREE_MINIMUM:
        return (uint32_t)(below(4) ? INT32_MIN : -20);
    case HR_PARAMETER_LAW_WINDOW_MAXIMUM:
    case HR_PARAMETER_HOME_MAXIMUM:
    case HR_PARAMETER_FREE_MAXIMUM:
        return (uint32_t)INT32_MAX;
    case HR_PARAMETER_HOME_STEP:
        return below(4) ? UINT32_C(1) << 30 : below(1000);
    case HR_PARAMETER_FIXED_SPEED_LIMIT:
        return below(4) ? (uint32_t)INT32_MAX : below(100);
    case HR_PARAMETER_FLOAT_SPEED_LIMIT:
        return below(4) ? bits_of(1e9f) : bits_of(10.0f);
    case HR_PARAMETER_FIXED_STIFFNESS:
    case HR_PARAMETER_FIXED_DAMPING:
    case HR_PARAMETER_FIXED_HOME_STIFFNESS:
    case HR_PARAMETER_FIXED_HOME_DAMPING:
    case HR_PARAMETER_FIXED_HOME_EFFORT_HIGH:
        return below(2000); /* below zero there is none */
    case HR_PARAMETER_EXCITATION_LINES:
        return below(4) ? 0 : 1 + below(3);
    case HR_PARAMETER_EXCITATION_PERIOD:
        return 7 + below(200);
    case HR_PARAMETER_EXCITATION_FIRST:
    case HR_PARAMETER_EXCITATION_STEP:
        return 1;
    default:
        break;
    }
    const bool is_choice = parameter->kind == HR_UNSIGNED && parameter->maximum < 256;
    return is_choice ? parameter->minimum + below(parameter->maximum - parameter->minimum + 1) : any_number(parameter);
}

static uint32_t host_value(size_t index)
{
    const uint32_t speeds[] = {0, 1000, UINT32_MAX};
    const struct hr_parameter *parameter = &hr_parameters[index];
    switch (index) {
    case HR_PARAMETER_VERIFIED:
        return 1;
    case HR_PARAMETER_MOTION:
        return 0;
    case HR_PARAMETER_CURRENT_LIMIT:
        return below(NARROWED_LIMIT + 1);
    case HR_PARAMETER_CONTINUOUS_CURRENT:
        return below(4) ? below(NARROWED_LIMIT + 1) : below(20); /* that a spike overheats */
    case HR_PARAMETER_WINDOW_MINIMUM:
        return (uint32_t)(below(4) ? INT32_MIN : -50);
    case HR_PARAMETER_WINDOW_MAXIMUM:
        return (uint32_t)INT32_MAX;
    case HR_PARAMETER_SPEED_LIMIT:
        return speeds[below(3)];
    default:
        return below(3) ? parameter->initial : below(2) ? parameter->minimum : parameter->maximum;
    }
}

/* A block of every parameter, most values inside their ranges; or of those alone that may change while it is armed. */
static size_t make_block(uint8_t *block, bool live_alone)
{
    const uint32_t law = below(3);
    const size_t wild = below(3) ? HR_PARAMETERS : below(HR_PARAMETERS);
    size_t count = 0;
    for (size_t i = 0; i < HR_PARAMETERS; i++) {
        if (live_alone && !hr_parameters[i].live)
            continue;
        const bool of_law = i >= HR_PARAMETER_LAW;
        const uint32_t value = i == wild ? (uint32_t)chance() : of_law ? law_value(i, law) : host_value(i);
        put(block + count, 2, hr_parameters[i].id);
        put(block + count + 2, 4, value);
        count += HR_PARAMETER_BYTES;
    }
    return count;
}

static void configure(struct fuzz *fuzz, bool live_alone)
{
    struct packet packet;
    uint8_t block[HR_FULL_BLOCK_BYTES];
    const size_t count = make_block(block, live_alone);
    const uint32_t crc = fuzz->host->device.configuration.crc;
    const bool lively = is_lively(fuzz);
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
        send(fuzz, &packet, !below(200));
    }
    begin(fuzz, &packet, HR_TYPE_SET_COMMIT, HR_BYTES_SET_COMMIT);
    send(fuzz, &packet, false);
    if (lively && crc != fuzz->host->device.configuration.crc)
        fuzz->lives++;
}

static void arm(struct fuzz *fuzz)
{
    struct packet packet;
    uint8_t *raw = begin(fuzz, &packet, HR_TYPE_ARM, HR_BYTES_ARM);
    put(raw + HR_AT_ARM_DICTIONARY_HASH, 8, fuzz->host->board.dictionary_hash);
    put(raw + HR_AT_ARM_PARAMETERS_CRC, 4, fuzz->host->device.configuration.crc);
    raw[HR_AT_HEADER_SESSION] = (uint8_t)below(256);
    fuzz->sequence = 0;
    fuzz->may_arm = true;
    send(fuzz, &packet, false);
}

static void disarm(struct fuzz *fuzz)
{
    struct packet packet;
    uint8_t *raw = begin(fuzz, &packet, HR_TYPE_DISARM, HR_BYTES_DISARM);
    raw[HR_AT_DISARM_FLAGS] = (uint8_t)below(2);
    fuzz->may_clear = fuzz->may_clear || raw[HR_AT_DISARM_FLAGS] != 0;
    fuzz->nonce++;
    send(fuzz, &packet, false);
}

static void command(struct fuzz *fuzz)
{
    struct packet packet;
    uint8_t *raw = begin(fuzz, &packet, HR_TYPE_COMMAND, HR_BYTES_COMMAND);
    const uint16_t newest = (uint16_t)(fuzz->host->device.connection.to_send[HR_INDEX_STATE] - 1u);
    put(raw + HR_AT_COMMAND_STATE_SEQUENCE, 2, below(8) ? newest : chance());
    put(raw + HR_AT_COMMAND_LIFETIME_US, 4, below(2) ? 20000u : chance());
    const bool runs_law = fuzz->host->device.renderer.there;
    const uint8_t usual = runs_law && below(8) ? HR_MODE_SUPERVISE : HR_MODE_CURRENT;
    raw[HR_AT_COMMAND_MODE] = (uint8_t)(below(32) ? usual : below(256));
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
    receive(fuzz, bytes, count);
}

/* What the device has sent: whole frames, and of a BATCH whole samples. */
static void take_all(struct fuzz *fuzz)
{
    static const size_t sample_bytes[] = {5, 3, 6};
    uint8_t away[256];
    size_t count;
    while ((count = host_take(fuzz->host, away, sizeof away)) > 0)
        for (size_t i = 0; i < count; i++) {
            const size_t raw = splitter_take(&fuzz->output, away[i], &fuzz->broken);
            const uint8_t *frame = splitter_raw(&fuzz->output);
            if (raw == 0 || frame[HR_AT_HEADER_TYPE_ID] != HR_TYPE_BATCH)
                continue;
            const uint8_t layout = frame[HR_AT_BATCH_LAYOUT];
            CHECK(raw > HR_BYTES_BATCH && layout < 3);
            CHECK((raw - HR_BYTES_BATCH) % sample_bytes[layout] == 0);
            fuzz->batches[layout]++;
        }
    CHECK(fuzz->broken.framing_errors == 0 && fuzz->broken.crc_errors == 0);
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
    CHECK(!is_lively(fuzz) || fuzz->may_arm || fuzz->state == HR_STATE_ARMED || fuzz->state == HR_STATE_RUNNING);
    CHECK(fuzz->latched == HR_FAULT_NONE || device->faults.latched == fuzz->latched || fuzz->may_clear);
    fuzz->state = state;
    fuzz->latched = device->faults.latched;
    fuzz->may_arm = fuzz->may_clear = false;
    if (device->tick.supervised) {
        fuzz->laws[device->configuration.values[HR_PARAMETER_LAW]]++;
        fuzz->phases[device->renderer.phase]++;
    }
    fuzz->states[state]++;
    fuzz->faults[device->faults.latched]++;
}

static void tick(struct fuzz *fuzz)
{
    struct host *host = fuzz->host;
    fuzz->ticks++;
    fuzz->ticks_armed += is_lively(fuzz);
    int32_t count = host->count + (int32_t)below(5) - 2;
    if (!below(1000))
        count = below(10) ? (int32_t)below(200) - 100 : (int32_t)(chance() >> 33) - (1 << 30);
    const uint8_t inputs = (uint8_t)(below(500) ? HR_INPUT_HOLD_TO_RUN : below(256));
    const int16_t measured = (int16_t)(below(300) ? host->current : (int32_t)below(65536) - 32768);
    const uint64_t late = below(100) ? 0 : below(below(10) ? 2u * host->device.period : 1000000u);
    host_set_world(host, host->device.due + late, count, below(2) ? host->time : 0, measured, inputs);
    host_set_clock(host, host->time, below(2000) ? 0 : below(20000));
    if (!below(5000))
        host_fail_encoder(host);
    host_tick(host);
    take_all(fuzz);
    host_set_room(host, below(50) ? HR_HOST_OUTPUT_BYTES : below(300));
}

/* Longer than any lifetime with its ramp, and than an armed device waits for its first command. */
static void fall_silent(struct fuzz *fuzz)
{
    const uint32_t *values = fuzz->host->device.configuration.values;
    const uint64_t lifetime = values[HR_PARAMETER_COMMAND_LIFETIME_US] > values[HR_PARAMETER_SUPERVISE_LIFETIME_US]
                                  ? values[HR_PARAMETER_COMMAND_LIFETIME_US]
                                  : values[HR_PARAMETER_SUPERVISE_LIFETIME_US];
    const uint64_t silence_us = 500000u + lifetime + values[HR_PARAMETER_RAMP_US];
    const uint64_t end = fuzz->host->device.time + silence_us * HR_TIME_UNITS_PER_US;
    while (fuzz->host->device.time <= end)
        tick(fuzz);
    fuzz->silences++;
    CHECK(!is_lively(fuzz) && fuzz->host->current == 0);
}

/* Those that nothing in a simulated world can cause. */
static void inject(struct fuzz *fuzz)
{
    const uint8_t faults[] = {HR_FAULT_NON_FINITE, HR_FAULT_WATCHDOG_RESET, HR_FAULT_INTERNAL, HR_FAULT_BATCH_OVERFLOW,
                              HR_FAULT_PROCESSOR_STOPPED, HR_FAULT_OUTPUT_STALLED};
    host_fault(fuzz->host, faults[below(sizeof faults)]);
}

/* All that leads to a session from anywhere. */
static void begin_session(struct fuzz *fuzz)
{
    identify(fuzz);
    disarm(fuzz);
    configure(fuzz, false);
    arm(fuzz);
}

static void restart(struct fuzz *fuzz)
{
    fuzz->may_clear = true;
    host_restart(fuzz->host);
}

/* Of 1000. Outside of a session much leads to one. */
static void step(struct fuzz *fuzz)
{
    const uint32_t which = below(1000);
    const bool lively = is_lively(fuzz);
    if (!below(50000))
        fall_silent(fuzz);
    else if (which < 2)
        noise(fuzz);
    else if (which < 3)
        inject(fuzz);
    else if (which < 5)
        restart(fuzz);
    else if (which < 40)
        send_any(fuzz);
    else if (which < 50)
        identify(fuzz);
    else if (which < 60)
        configure(fuzz, false);
    else if (which < 75)
        configure(fuzz, true);
    else if (which < 85)
        arm(fuzz);
    else if (which < 90)
        disarm(fuzz);
    else if (!lively && which < 350)
        begin_session(fuzz);
    else if (which < 600)
        command(fuzz);
    else
        tick(fuzz);
}

int main(int count, char **arguments)
{
    static const uint8_t dictionary[] = "not a dictionary, and nobody minds";
    const struct board_setup setup = {
        .dictionary = dictionary,
        .dictionary_hash = 7,
        .dictionary_bytes = sizeof dictionary,
        .rate_initial = 1000,
        .encoder_sign = 1,
        .over_current = 5500,
        .mechanics = {1e-4, 1.0, 2e-3, 6e-4, 1e-3, 0.0, 0.0},
        .current_sensor = {.noise = 300.0}, /* what is measured is left to chance, now and then */
    };
    struct fuzz fuzz = {.host = calloc(1, host_bytes())};
    CHECK(count == 3 && fuzz.host != NULL);
    state_of_chance = strtoull(arguments[1], NULL, 10);
    host_setup(fuzz.host, &setup);
    host_narrow(fuzz.host, HR_PARAMETER_CURRENT_LIMIT, 0, NARROWED_LIMIT);
    host_narrow(fuzz.host, HR_PARAMETER_CONTINUOUS_CURRENT, 0, NARROWED_LIMIT);
    host_start(fuzz.host);
    splitter_reset(&fuzz.output);
    for (unsigned long left = strtoul(arguments[2], NULL, 10); left > 0; left--) {
        step(&fuzz);
        check(&fuzz);
    }
    for (size_t i = 0; i < HR_STATES; i++)
        printf("state %zu %u\n", i, fuzz.states[i]);
    for (size_t i = 0; i < sizeof fuzz.faults / sizeof fuzz.faults[0]; i++)
        printf("fault %zu %u\n", i, fuzz.faults[i]);
    for (size_t i = 1; i < 3; i++)
        printf("law %zu %u\n", i, fuzz.laws[i]);
    for (size_t i = 0; i <= LAW_FREE; i++)
        printf("phase %zu %u\n", i, fuzz.phases[i]);
    for (size_t i = 0; i < 3; i++)
        printf("layout %zu %u\n", i, fuzz.batches[i]);
    printf("live 0 %u\n", fuzz.lives);
    printf("sum bytes %llu\n", (unsigned long long)fuzz.bytes);
    printf("sum ticks %u\n", fuzz.ticks);
    printf("sum ticks_armed %u\n", fuzz.ticks_armed);
    printf("sum silences %u\n", fuzz.silences);
    free(fuzz.host);
    return 0;
}
