/* Run a bridge in real time on Linux: wait for its host, its bus and the next period, and move bytes. */
#ifndef HR_BRIDGE_LOOP_H
#define HR_BRIDGE_LOOP_H

#include <stdbool.h>
#include <stdint.h>

#include "bridge.h"

struct bridge_ends {
    int host; /* a pseudo-terminal's master, or a socket */
    int bus;
    int wake; /* becomes readable when the loop must end */
    bool host_stays; /* a host that hangs up may come again: a pseudo-terminal */
};

/* Run until `wake` is readable, or the host of a socket has disconnected. At the return the drive is off. */
void bridge_run(struct bridge *bridge, const struct bridge_ends *ends);

#endif
