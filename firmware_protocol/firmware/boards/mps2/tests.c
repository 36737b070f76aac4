/* The image for tests: the port check if a file requests it, else lock-step with a plant. */
#include "tests.h"

#include "mps2.h"
#include "semihosting.h"

#define NO_FILES 2u

int main(void)
{
    const bool simulates = semihosting_open_to_read("simulate") >= 0;
    const int32_t requests = semihosting_open_to_read("requests");
    const int32_t replies = semihosting_open_to_write("replies");
    if (requests < 0 || replies < 0)
        semihosting_exit(NO_FILES);
    semihosting_exit(simulates ? simulated_port(requests, replies) : lockstep(requests, replies));
    return 0;
}
