/* How it counts. Each channel of the encoder has a state machine that waits for the channel's next edge, looks at the other
 * channel, and counts: edges forwards in X, backwards in Y, both downwards because that is all that PIO can. The
 * place in the program is the channel's level, so nothing is decoded and nothing can be missed that lasts for the
 * three cycles of an edge. The processor reads the four numbers by putting an instruction into the machines; one
 * edge at most falls into the eight cycles which that takes, so the sum is a count that the encoder had meanwhile.
 *
 * A third machine looks at both channels every three cycles. At a change it has the DMA take down the time, and when both
 * channels have changed since it last looked (10 cycles ago when it was busy) it raises a flag: dirt, a broken wire,
 * or more than a count in 80 ns. A fourth does the same for the sync input. */
#include "encoder.h"

#include "board_config.h"
#include "clocks.h"
#include "protocol.h"
#include "registers.h"
#include "timekeeping.h"

enum { MACHINE_A, MACHINE_B, MACHINE_GUARD, MACHINE_SYNC };
enum { DMA_EDGE = 0, DMA_SYNC = 3 }; /* three channels each */

#define FLAG_ILLEGAL 1u

/* RP2040 data sheet, 3.4: instructions of PIO, without delay and side-set. */
#define JUMP(to) (0x0000u | (to))
#define JUMP_X_DECREMENT(to) (0x0040u | (to)) /* if X was not zero; X is decremented in any case */
#define JUMP_Y_DECREMENT(to) (0x0080u | (to))
#define JUMP_X_NOT_Y(to) (0x00A0u | (to))
#define JUMP_PIN(to) (0x00C0u | (to))
#define WAIT_LOW 0x2020u /* for the machine's first input pin */
#define WAIT_HIGH 0x20A0u
#define IN_X_32 0x4020u
#define IN_Y_32 0x4040u
#define OUT_X(bits) (0x6020u | (bits))
#define OUT_Y(bits) (0x6040u | (bits))
#define PUSH_OR_DROP 0x8000u
#define MOVE_Y_FROM_X 0xA041u
#define MOVE_OUT_FROM_PINS 0xA0E0u
#define MOVE_OUT_FROM_NOT_Y 0xA0EAu
#define RAISE_FLAG_0 0xC000u
#define SET_X(value) (0xE020u | (value))
#define SET_Y(value) (0xE040u | (value))

enum {
    WAIT_FOR_RISE = 0,
    RISE_BACKWARDS = 4,
    WAIT_FOR_FALL = 5,
    FALL_FORWARDS = 9,
    CHANNEL_ENDS = 9,
    LOOK = 10,
    LOOK_ENDS = 12,
    CHANGED = 13,
    LEGAL = 17,
    SYNC = 20,
    SYNC_ENDS = 22,
};

static const uint16_t program[] = {
    /* One channel, seen from A: a rise while B is low goes forwards. From B it is the other way round. */
    [WAIT_FOR_RISE] = WAIT_HIGH,
    [1] = JUMP_PIN(RISE_BACKWARDS), /* the other channel */
    [2] = JUMP_X_DECREMENT(WAIT_FOR_FALL),
    [3] = JUMP(WAIT_FOR_FALL), /* X was zero */
    [RISE_BACKWARDS] = JUMP_Y_DECREMENT(WAIT_FOR_FALL),
    [WAIT_FOR_FALL] = WAIT_LOW,
    [6] = JUMP_PIN(FALL_FORWARDS),
    [7] = JUMP_Y_DECREMENT(WAIT_FOR_RISE),
    [8] = JUMP(WAIT_FOR_RISE),
    [FALL_FORWARDS] = JUMP_X_DECREMENT(WAIT_FOR_RISE),

    /* Both channels: X as they are, Y as they were. */
    [LOOK] = MOVE_OUT_FROM_PINS,
    [11] = OUT_X(2),
    [LOOK_ENDS] = JUMP_X_NOT_Y(CHANGED),
    [CHANGED] = MOVE_OUT_FROM_NOT_Y,
    [14] = OUT_Y(2),
    [15] = JUMP_X_NOT_Y(LEGAL), /* unless both are the opposite of what they were */
    [16] = RAISE_FLAG_0,
    [LEGAL] = MOVE_Y_FROM_X,
    [18] = PUSH_OR_DROP,
    [19] = JUMP(LOOK),

    [SYNC] = WAIT_LOW,
    [21] = WAIT_HIGH,
    [SYNC_ENDS] = PUSH_OR_DROP,
};

static struct watched {
    uint32_t ignored; /* what the machine pushed */
    struct stamp stamp;
    uint32_t fine, coarse; /* of the stamp that `time` is of */
    uint64_t time;
} edge, sync;

static uint32_t level(uint32_t pin)
{
    return SIO_IN >> pin & 1u;
}

static void execute(uint32_t machine, uint32_t instruction)
{
    PIO_INSTRUCTION(machine) = instruction;
}

static void start_machine(uint32_t machine, uint32_t pin, uint32_t other, uint32_t begins, uint32_t from, uint32_t to)
{
    PIO_DIVIDER(machine) = PIO_NOT_DIVIDED;
    PIO_EXECUTION(machine) = PIO_JUMP_PIN(other) | PIO_WRAP(from, to);
    PIO_SHIFTING(machine) = PIO_SHIFT_IN_RIGHT | PIO_SHIFT_OUT_RIGHT | (machine <= MACHINE_B ? PIO_PUSH_ALL_32 : 0u);
    PIO_PINS(machine) = PIO_IN_FROM(pin);
    execute(machine, SET_X(0));
    execute(machine, SET_Y(0));
    execute(machine, JUMP(begins));
}

/* Three DMA channels in a ring: the first waits for a push, the others take down both parts of the time. */
static void start_stamps(uint32_t first, uint32_t machine, struct watched *watched)
{
    const uint32_t from[] = {(uint32_t)&PIO_RECEIVED(machine), (uint32_t)&PWM_COUNTER(TIME_SLICE), TIMER_RAW_LOW};
    const uint32_t to[] = {(uint32_t)&watched->ignored, (uint32_t)&watched->stamp.fine,
                           (uint32_t)&watched->stamp.coarse};
    const uint32_t when[] = {REQUEST_PIO0_RECEIVED(machine), REQUEST_ALWAYS, REQUEST_ALWAYS};
    for (uint32_t i = 3; i-- > 0;) {
        const uint32_t control = DMA_ENABLE | DMA_WORDS | DMA_QUIET | DMA_WHEN(when[i])
                                 | DMA_THEN(first + (i + 1u) % 3u);
        DMA_FROM(first + i) = from[i];
        DMA_TO(first + i) = to[i];
        DMA_COUNT(first + i) = 1;
        if (i > 0)
            DMA_CONTROL(first + i) = control;
        else
            DMA_CONTROL_START(first + i) = control;
    }
}

void encoder_start(void)
{
    const uint32_t a = BOARD_ENCODER_PIN, b = a + 1u;
    for (uint32_t i = 0; i < sizeof program / sizeof program[0]; i++)
        PIO_MEMORY(i) = program[i];
    /* An edge between this look and the start is counted: the machine finds its level there already. */
    start_machine(MACHINE_A, a, b, level(a) ? WAIT_FOR_FALL : WAIT_FOR_RISE, WAIT_FOR_RISE, CHANNEL_ENDS);
    start_machine(MACHINE_B, b, a, level(b) ? WAIT_FOR_FALL : WAIT_FOR_RISE, WAIT_FOR_RISE, CHANNEL_ENDS);
    start_machine(MACHINE_GUARD, a, b, LOOK, LOOK, LOOK_ENDS);
    execute(MACHINE_GUARD, SET_Y(level(a) | level(b) << 1));
    start_machine(MACHINE_SYNC, BOARD_SYNC_IN_PIN, 0, SYNC, SYNC, SYNC_ENDS);
    start_stamps(DMA_EDGE, MACHINE_GUARD, &edge);
    start_stamps(DMA_SYNC, MACHINE_SYNC, &sync);
    PIO_CONTROL = 0xFu;
#if defined(BOARD_ENCODER_INDEX_WIRED)
    GPIO_EVENTS(BOARD_ENCODER_INDEX_PIN) = GPIO_ROSE(BOARD_ENCODER_INDEX_PIN); /* what its pad's start looked like */
#endif
}

int32_t encoder_count(void)
{
    execute(MACHINE_A, IN_X_32);
    execute(MACHINE_B, IN_X_32);
    execute(MACHINE_A, IN_Y_32);
    execute(MACHINE_B, IN_Y_32);
    while (PIO_FIFO_STATUS & (PIO_RECEIVED_NONE(MACHINE_A) | PIO_RECEIVED_NONE(MACHINE_B)))
        continue; /* not even once: the machines need a cycle each */
    uint32_t count = PIO_RECEIVED(MACHINE_B) - PIO_RECEIVED(MACHINE_A);
    count += PIO_RECEIVED(MACHINE_A) - PIO_RECEIVED(MACHINE_B);
    return count <= INT32_MAX ? (int32_t)count : -1 - (int32_t)~count;
}

#if defined(BOARD_ENCODER_LINES_COMPLEMENTARY)
#define BROKEN_AFTER (2000u * HR_TIME_UNITS_PER_US)

/* A line and its complement that are equal: in the middle of an edge for some nanoseconds, longer with a broken wire. The
 * pull-ups make a pulled plug equal too. So they must have been equal at every look for a while. */
static bool wire_is_broken(void)
{
    static uint64_t whole_at;
    const uint64_t now = time_now();
    const uint32_t levels = SIO_IN;
    const uint32_t differ = (levels >> BOARD_ENCODER_PIN ^ levels >> BOARD_ENCODER_COMPLEMENT_PIN) & 3u;
    if (differ == 3u)
        whole_at = now;
    return now - whole_at > BROKEN_AFTER;
}
#else
static bool wire_is_broken(void)
{
    return false;
}
#endif

bool encoder_failed(void)
{
    const uint32_t raised = PIO_FLAGS & FLAG_ILLEGAL;
    PIO_FLAGS = raised;
    return raised != 0 || wire_is_broken();
}

#if defined(BOARD_ENCODER_INDEX_WIRED)
static struct {
    uint32_t edges;
    int32_t count;
} index_seen;

/* The pin latches a rise until the latch is cleared, so that none is too short to be seen. */
void encoder_look_for_index(void)
{
    const uint32_t rose = GPIO_ROSE(BOARD_ENCODER_INDEX_PIN);
    if (!(GPIO_EVENTS(BOARD_ENCODER_INDEX_PIN) & rose))
        return;
    GPIO_EVENTS(BOARD_ENCODER_INDEX_PIN) = rose;
    index_seen.count = encoder_count();
    index_seen.edges++;
}

uint32_t encoder_index_edges(int32_t *count)
{
    *count = index_seen.count;
    return index_seen.edges;
}
#endif

/* A stamp is unique for an hour only, so it is converted to device time while it is new. */
static uint64_t time_of_last(struct watched *watched)
{
    uint32_t fine, coarse;
    stamp_read(&watched->stamp, &fine, &coarse);
    if (fine != watched->fine || coarse != watched->coarse) {
        watched->fine = fine;
        watched->coarse = coarse;
        watched->time = time_of(fine, coarse);
    }
    return watched->time;
}

uint64_t encoder_edge_time(void)
{
    return time_of_last(&edge);
}

uint64_t encoder_sync_time(void)
{
    return time_of_last(&sync);
}
