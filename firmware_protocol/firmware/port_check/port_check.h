/* Requests of the host to the port check program, and its replies: rig/firmware/_port_check.py has the same list
 * and says what the numbers mean for the port's duties (duties.toml).
 *
 * Frames as in PROTOCOL.md, with the protocol's header: a question has type 0x3C, nonce u16, probe u16, then the arguments,
 * u32 each; the answer has type 0x3D, the nonce, the probe, then its numbers, u32 each. Frames of type 0x3F count: index u32. */
#ifndef HR_PORT_CHECK_H
#define HR_PORT_CHECK_H

#define PORT_CHECK_QUESTION 0x3Cu
#define PORT_CHECK_ANSWER 0x3Du
#define PORT_CHECK_COUNTED 0x3Fu

/* Times are in 1/16 µs, currents in quanta. */
enum port_check_probe {
    PROBE_BOARD,    /* -> what it was built for: see report_board */
    PROBE_TIME,     /* -> time (low, high) */
    PROBE_TICKS,    /* rate or 0: as it is, ticks -> accepted, ticks, from first to last, distance from the grid: least, most, last */
    PROBE_RATE,     /* rate -> accepted; the old one is back behind it */
    PROBE_HOLD,     /* -> ticks in a poll that takes three periods; polls, and ticks, in a tick that does */
    PROBE_OFF,      /* current -> largest current with the amplifier off, and the last; then switched on at this set-point: largest */
    PROBE_ON,       /* current -> first look, mean when it has settled, how long it flows behind set_current(0) */
    PROBE_DISABLE,  /* current -> how long it flows behind enable(false) */
    PROBE_FILL,     /* frames at most -> taken, bytes taken before the first refusal, refused, longest call, sum of the taken ones' numbers */
    PROBE_WIRES,    /* -> what sync outputs wired to the encoder and the sync input show: see try_wires */
    PROBE_BITE,     /* µs -> how long it was not fed (ms) and lives; counted frames meanwhile, one a millisecond */
    PROBE_SUMMARY,  /* -> what was seen meanwhile: see report_summary */
    PROBE_LEAVE     /* -> nothing: the board shows its boot loader */
};

#endif
