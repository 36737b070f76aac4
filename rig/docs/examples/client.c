/* A host in C without any library: ask a device of the wire protocol who it is. Nothing moves.
 *
 *     rig serve rig                                  # prints the port of a simulated rig
 *     cc -o client client.c && ./client /dev/pts/3   # that port, or a board at /dev/ttyACM0
 *
 * Every byte: firmware_protocol/PROTOCOL.md. */
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

enum { MAJOR = 2, IDENTIFY = 0x00, IDENTITY = 0x01, HEADER = 6, CRC = 4, LIMIT = 300 };

static uint32_t crc32(const uint8_t *bytes, size_t count) {
    uint32_t crc = UINT32_MAX;
    for (size_t i = 0; i < count; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

/* COBS: each zero is replaced by the distance to the next one; 0x00 ends the frame. Frames are shorter than 254 bytes. */
static size_t stuff(const uint8_t *raw, size_t count, uint8_t *out) {
    size_t code = 0, end = 1;
    for (size_t i = 0; i <= count; i++) {
        if (i < count && raw[i]) {
            out[end++] = raw[i];
            continue;
        }
        out[code] = (uint8_t)(end - code);
        code = end++;
    }
    out[code] = 0;
    return code + 1;
}

static size_t unstuff(const uint8_t *in, size_t count, uint8_t *raw) {
    size_t end = 0;
    for (size_t at = 0; at < count; at += in[at]) {
        if (at) raw[end++] = 0;
        for (size_t i = 1; i < in[at] && at + i < count; i++) raw[end++] = in[at + i];
    }
    return end;
}

int main(int argc, char **argv) {
    int port = argc > 1 ? open(argv[1], O_RDWR | O_NOCTTY) : -1;
    struct termios mode;
    if (port < 0 || tcgetattr(port, &mode)) return fprintf(stderr, "usage: client PORT (of a device)\n"), 1;
    cfmakeraw(&mode);
    mode.c_cc[VMIN] = 0, mode.c_cc[VTIME] = 10; /* at most 1 s of silence */
    tcsetattr(port, TCSANOW, &mode);

    uint8_t raw[LIMIT] = {MAJOR, IDENTIFY, 0, 0, 0, 0, /* nonce */ 1, 0, /* offset */ 0, 0}, wire[LIMIT];
    size_t count = 10, got = 0;
    uint32_t crc = crc32(raw, count);
    for (int i = 0; i < CRC; i++) raw[count++] = (uint8_t)(crc >> 8 * i);
    wire[0] = 0; /* ends what an earlier host may have left on the line */
    if (write(port, wire, 1) != 1 || write(port, wire, stuff(raw, count, wire)) < 0) return perror(argv[1]), 1;

    while (got < LIMIT && read(port, wire + got, 1) == 1) {
        if (wire[got]) {
            got++;
            continue;
        }
        count = unstuff(wire, got, raw), got = 0;
        if (count < HEADER + 16 + CRC || raw[1] != IDENTITY) continue; /* a STATE, or noise */
        crc = crc32(raw, count - CRC);
        for (int i = 0; i < CRC; i++)
            if (raw[count - CRC + i] != (uint8_t)(crc >> 8 * i)) return fprintf(stderr, "damaged frame\n"), 1;
        printf("protocol %d.%d, state %d, dictionary of %d bytes\n", raw[0], raw[8], raw[9], raw[18] | raw[19] << 8);
        return 0;
    }
    return fprintf(stderr, "no reply from %s\n", argv[1]), 1;
}
