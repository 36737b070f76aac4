/* The image for tests: golden vectors where there is a file of them, else lock-step with a plant. */
#include "tests.h"

#include "mps2.h"
#include "semihosting.h"

#define NO_FILES 2u

int main(void)
{
    const int32_t vectors = semihosting_open_to_read("vectors");
    if (vectors >= 0)
        semihosting_exit(law_vectors(vectors));
    const int32_t requests = semihosting_open_to_read("requests");
    const int32_t replies = semihosting_open_to_write("replies");
    semihosting_exit(requests < 0 || replies < 0 ? NO_FILES : lockstep(requests, replies));
    return 0;
}
