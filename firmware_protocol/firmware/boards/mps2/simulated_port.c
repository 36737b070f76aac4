/* The port to a computer as a board in simulated time (port_check/simulated), on this processor: the port check with
 * another compiler's integers and floats.
 *
 * Request, little-endian: time to let pass (µs) u32, bytes of the host u8, 3 × 0, then room for 64 of them. Reply: its bytes u32,
 * then these. */
#include "../../port_check/simulated/simulated_board.h"

#include "bytes.h"
#include "semihosting.h"
#include "tests.h"

#define AT_COUNT 4
#define AT_BYTES 8
#define HOST_BYTES 64
#define REPLY_HEAD_BYTES 4u
#define REPLY_BYTES 4096u

static struct simulated_board board;
static uint8_t reply[REPLY_HEAD_BYTES + REPLY_BYTES];

uint32_t simulated_port(int32_t requests, int32_t replies)
{
    uint8_t request[AT_BYTES + HOST_BYTES];
    simulated_board_start(&board, NULL);
    while (semihosting_read(requests, request, sizeof request)) {
        const size_t count = simulated_board_run(&board, get_u32(request), request + AT_BYTES, request[AT_COUNT],
                                                 reply + REPLY_HEAD_BYTES, REPLY_BYTES);
        put_u32(reply, (uint32_t)count);
        semihosting_write(replies, reply, REPLY_HEAD_BYTES + count);
    }
    return 0;
}
