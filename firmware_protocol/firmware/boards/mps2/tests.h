/* What the image for tests can do; main chooses by the files that it finds. */
#ifndef HR_TESTS_H
#define HR_TESTS_H

#include <stdint.h>

/* Be the device of a plant outside, until there are no more requests; returns the exit code. */
uint32_t lockstep(int32_t requests, int32_t replies);

/* Run the port check on the port to a computer, likewise. */
uint32_t simulated_port(int32_t requests, int32_t replies);

#endif
