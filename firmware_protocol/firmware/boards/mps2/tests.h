/* The programs of the image for tests; main chooses one by the files that it finds. */
#ifndef HR_TESTS_H
#define HR_TESTS_H

#include <stdint.h>

/* Run as the device of a plant outside of the emulator until no more requests come; returns the exit code. */
uint32_t lockstep(int32_t requests, int32_t replies);

/* Run the port check on the port to a computer until no more requests come; returns the exit code. */
uint32_t simulated_port(int32_t requests, int32_t replies);

#endif
