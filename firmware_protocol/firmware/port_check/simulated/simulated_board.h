/* The port to a computer (host/) as a simulated board in simulated time, so that the port check (port_check.h) can run on
 * it, and on ports with one fault.
 *
 * Each reading of the clock advances the time. A tick comes between two polls, as on a board that masks its interrupt in a
 * poll. The motor's current follows the set-point with a lag, the line sends at its rate, sync outputs are wired to the
 * encoder and the sync input, and the watchdog resets the board. */
#ifndef HR_SIMULATED_BOARD_H
#define HR_SIMULATED_BOARD_H

#include "../../host/host.h"

struct simulated_board {
    struct host host;     /* the port: its functions and its constants */
    struct hal hal;       /* what the program is given: the port's, spoilt or not */
    struct device device;
    uint64_t tick_at, bites_at, taken_at, ends;
    uint32_t feeds, rate; /* as last seen of the port */
    float flows;          /* quanta */
    uint8_t wires;        /* what the sync outputs have shown */
    bool reports_reset;   /* after a reset by the watchdog */
    size_t line_count;
    uint8_t line[4u * HR_HOST_OUTPUT_BYTES]; /* what has left, for a host that reads now and then */
};

/* Power up the board with a port that `spoil` changes; NULL: an unchanged port. */
void simulated_board_start(struct simulated_board *board, void (*spoil)(struct simulated_board *board));

/* Pass bytes to the port, let time pass (µs), and take the bytes that it sent; returns their number. */
size_t simulated_board_run(struct simulated_board *board, uint32_t us, const uint8_t *bytes, size_t count, uint8_t *into,
                           size_t capacity);

/* Update the board as time passes; a port's clock calls it. */
uint64_t simulated_board_time(void *context);

/* Run a tick, if one is due. */
void simulated_board_tick(struct simulated_board *board);

/* Run a poll of the link. */
void simulated_board_poll(struct simulated_board *board);

size_t simulated_board_bytes(void);

#endif
