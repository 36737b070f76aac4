/* The device in lock-step with a plant outside of the emulator: a request with the world at a sample, a tick of the board, a
 * reply with the current and what the device has sent. Time stands still while the plant is worked on.
 *
 * Request, little-endian: bytes of the host u8, inputs u8, measured current i16, count i32, time u64, time of the
 * last edge u64, whether to tick u8, 7 × 0, then room for 64 bytes of the host. Reply: its length u16, current i16, state u8,
 * enable u8, 0 u16, rate u32, then the bytes for the host. */
#include "../../host/host.h"

#include "board_config.h"
#include "bytes.h"
#include "semihosting.h"
#include "tests.h"

#define AT_MEASURED 2
#define AT_COUNT 4
#define AT_TIME 8
#define AT_EDGE_TIME 16
#define AT_TICKS 24
#define AT_BYTES 32
#define HOST_BYTES 64
#define REPLY_HEAD_BYTES 12

static struct host host;
static uint8_t reply[REPLY_HEAD_BYTES + HR_HOST_OUTPUT_BYTES];

static void work_on(const uint8_t *request)
{
    host_set_world(&host, get_u64(request + AT_TIME), signed_32(get_u32(request + AT_COUNT)),
                   get_u64(request + AT_EDGE_TIME), signed_16(get_u16(request + AT_MEASURED)), request[1]);
    host_receive(&host, request + AT_BYTES, request[0]);
    if (request[AT_TICKS]) {
        host_tick(&host);
        host_poll(&host, request, 0); /* what a board does between two ticks, bytes or not */
    }
}

static size_t fill_reply(void)
{
    struct host_status status;
    const size_t count = host_take(&host, reply + REPLY_HEAD_BYTES, UINT16_MAX - REPLY_HEAD_BYTES);
    host_status(&host, &status);
    put_u16(reply, (uint16_t)(REPLY_HEAD_BYTES + count));
    put_u16(reply + 2, (uint16_t)status.current);
    reply[4] = status.state;
    reply[5] = status.enabled;
    put_u16(reply + 6, 0);
    put_u32(reply + 8, status.rate);
    return REPLY_HEAD_BYTES + count;
}

uint32_t lockstep(int32_t requests, int32_t replies)
{
    uint8_t request[AT_BYTES + HOST_BYTES];
    const struct board_setup nothing = {0};
    host_setup(&host, &nothing);
    host.board = board_config;
    host_start(&host);
    while (semihosting_read(requests, request, sizeof request)) {
        work_on(request);
        semihosting_write(replies, reply, fill_reply());
    }
    return 0;
}
