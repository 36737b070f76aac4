#include "simulated_board.h"

#include <string.h>

#define UNITS_PER_US HR_TIME_UNITS_PER_US
#define UNITS_PER_SECOND (UNITS_PER_US * 1000000u)
#define STARTS_AT (UINT64_C(0x100000000) - UNITS_PER_SECOND / 4u) /* so that 32 bits are soon too few */
#define LOOK_UNITS 8u                                        /* that a look at the clock takes */
#define IDLE_UNITS 64u                                       /* that a poll takes besides */
#define LINE_BYTES_A_SECOND 300000u
#define LINE_UNITS (200u * UNITS_PER_US) /* it takes bytes in pieces, as a packet does */
#define ROOM_BYTES 28672u
#define LAG_S 1e-4
#define LAG_UNITS ((float)(LAG_S * UNITS_PER_SECOND))
#define OVER_CURRENT 2000u
#define RATE_INITIAL 1000u
#define RATE_MAXIMUM 50000u

/* port_check.c, under the names that core_beside.c gives it. */
void port_check_start(struct device *device, const struct hal *hal, const struct board *board);
void port_check_was_reset(struct device *device, uint32_t stopped_at);
void port_check_tick(struct device *device);
size_t port_check_poll(struct device *device);

/* ------------------------------------------------------------------ the world */

static void move_motor(struct simulated_board *board, uint64_t units)
{
    const float wanted = board->host.enabled ? board->host.current : 0.0f;
    const float share = (float)units / LAG_UNITS; /* steps are short against the lag */
    board->flows += (wanted - board->flows) * (share < 1.0f ? share : 1.0f);
    board->host.measured = (int16_t)(board->flows < 0.0f ? board->flows - 0.5f : board->flows + 0.5f);
}

static void move_line(struct simulated_board *board)
{
    if (board->host.time - board->taken_at < LINE_UNITS)
        return;
    const uint64_t bytes = (board->host.time - board->taken_at) * LINE_BYTES_A_SECOND / UNITS_PER_SECOND;
    board->taken_at += bytes * UNITS_PER_SECOND / LINE_BYTES_A_SECOND;
    const size_t room = sizeof board->line - board->line_count;
    board->line_count += host_take(&board->host, board->line + board->line_count, bytes < room ? (size_t)bytes : room);
}

/* Outputs tick and trial to channels A and B, inside to the sync input. */
static void move_wires(struct simulated_board *board)
{
    static const int8_t place[] = {0, 1, 3, 2}; /* of both lines in a period of the encoder */
    struct host *host = &board->host;
    const int moved = (place[host->sync & 3] - place[board->wires & 3] + 4) % 4;
    const uint8_t rose = host->sync & (uint8_t)~board->wires;
    if (moved == 2)
        host_fail_encoder(host);
    if (moved != 0) {
        host->count += moved == 3 ? -1 : moved;
        host->edge_time = host->time;
    }
    if (rose & HR_SYNC_INSIDE)
        host_set_sync_time(host, host->time);
    host->inputs = (uint8_t)(HR_INPUT_HOLD_TO_RUN | (host->sync & HR_SYNC_INSIDE ? HR_INPUT_SYNC : 0));
    board->wires = host->sync;
}

static void move_watchdog(struct simulated_board *board)
{
    if (board->host.feeds != board->feeds) {
        board->feeds = board->host.feeds;
        board->bites_at = board->host.time + (uint64_t)board->host.bite_us * UNITS_PER_US;
    }
}

static void move(struct simulated_board *board, uint64_t units)
{
    board->host.time += units;
    move_motor(board, units);
    move_line(board);
    move_watchdog(board);
}

uint64_t simulated_board_time(void *context)
{
    struct simulated_board *board = context; /* which begins with the host */
    move(board, LOOK_UNITS);
    return board->host.time;
}

/* No edge may be left out between two looks at the clock. */
static void sync_outputs(void *context, uint8_t bits)
{
    struct simulated_board *board = context;
    board->host.hal.sync(context, bits);
    move_wires(board);
}

/* ------------------------------------------------------------------ the board */

/* The timer: one tick that could not be served waits, and no more than one. */
void simulated_board_tick(struct simulated_board *board)
{
    const uint64_t now = board->host.time;
    const uint64_t period = UNITS_PER_SECOND / board->host.rate;
    if (board->host.rate != board->rate) {
        board->rate = board->host.rate;
        board->tick_at = now + period;
    }
    if (now < board->tick_at)
        return;
    board->tick_at += (now - board->tick_at) / period * period + period;
    port_check_tick(&board->device);
}

void simulated_board_poll(struct simulated_board *board)
{
    port_check_poll(&board->device);
}

static void power_up(struct simulated_board *board, bool bitten)
{
    board->rate = 0;
    board->feeds = board->host.feeds;
    board->bites_at = UINT64_MAX; /* until it is fed first */
    port_check_start(&board->device, &board->hal, &board->host.board);
    if (bitten && board->reports_reset)
        port_check_was_reset(&board->device, 0);
}

void simulated_board_start(struct simulated_board *board, void (*spoil)(struct simulated_board *board))
{
    const struct board_setup setup = {
        .rate_initial = RATE_INITIAL,
        .encoder_sign = 1,
        .over_current = OVER_CURRENT,
        .current_sensor = {.noise = 0.5, .lag_s = LAG_S},
    };
    memset(board, 0, sizeof *board);
    host_setup(&board->host, &setup);
    host_narrow(&board->host, HR_PARAMETER_POSITION_RATE, 50, RATE_MAXIMUM);
    host_set_room(&board->host, ROOM_BYTES);
    host_let_leave(&board->host);
    board->reports_reset = true;
    board->host.time = board->taken_at = board->ends = STARTS_AT;
    board->hal = board->host.hal;
    board->hal.time = simulated_board_time;
    board->hal.sync = sync_outputs;
    if (spoil != NULL)
        spoil(board);
    power_up(board, false);
}

size_t simulated_board_run(struct simulated_board *board, uint32_t us, const uint8_t *bytes, size_t count, uint8_t *into,
                           size_t capacity)
{
    board->ends += (uint64_t)us * UNITS_PER_US; /* a poll that takes longer takes of the next run's time */
    board->host.input = bytes;
    board->host.input_count = count;
    while (board->host.time < board->ends || (board->host.input_count > 0 && !board->host.left)) {
        if (!board->host.left) {
            simulated_board_poll(board);
            simulated_board_tick(board);
        }
        move(board, IDLE_UNITS);
        if (board->host.time >= board->bites_at && !board->host.left) {
            board->host.input_count = 0;
            power_up(board, true);
        }
    }
    const size_t taken = board->line_count < capacity ? board->line_count : capacity;
    memcpy(into, board->line, taken);
    memmove(board->line, board->line + taken, board->line_count - taken);
    board->line_count -= taken;
    return taken;
}

size_t simulated_board_bytes(void)
{
    return sizeof(struct simulated_board);
}
