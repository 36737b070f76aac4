#include "fdcanusb.h"

#include <string.h>

#define POLYNOMIAL 0x97u
#define CHECKSUM_BYTES 4u /* behind the text: a space, a star, two digits */

static uint8_t crc_of(const char *text, size_t count)
{
    unsigned crc = 0;
    for (size_t i = 0; i < count; i++) {
        crc ^= (uint8_t)text[i];
        for (unsigned bit = 0; bit < 8; bit++)
            crc = crc & 0x80u ? (crc << 1 ^ POLYNOMIAL) & 0xFFu : crc << 1 & 0xFFu;
    }
    return (uint8_t)crc;
}

/* ------------------------------------------------------------------ to the adapter */

static char *put_hex(char *at, uint32_t value, unsigned digits)
{
    while (digits-- > 0)
        *at++ = "0123456789ABCDEF"[value >> 4 * digits & 15u];
    return at;
}

size_t fdcanusb_make(const struct fdcanusb *port, const struct can_frame_bytes *frame, uint8_t *into)
{
    char line[FDCANUSB_LINE_BYTES];
    char *at = line;
    memcpy(at, "can send ", 9);
    at = put_hex(at + 9, frame->id, frame->id > 0xFFFFu ? 8 : 4);
    *at++ = ' ';
    for (size_t i = 0; i < frame->count; i++)
        at = put_hex(at, frame->bytes[i], 2);
    memcpy(at, " BF", 3); /* at the higher bit rate, CAN FD */
    at += 3;
    if (port->checksum) {
        *at++ = ' ';
        const uint8_t crc = crc_of(line, (size_t)(at - line));
        *at++ = '*';
        at = put_hex(at, crc, 2);
    }
    *at++ = '\n';
    memcpy(into, line, (size_t)(at - line));
    return (size_t)(at - line);
}

/* ------------------------------------------------------------------ from the adapter */

/* Return the value of a hexadecimal digit, 16 for another character. */
static unsigned digit(char character)
{
    if (character >= '0' && character <= '9')
        return (unsigned)(character - '0');
    if (character >= 'a' && character <= 'f')
        return (unsigned)(character - 'a') + 10u;
    if (character >= 'A' && character <= 'F')
        return (unsigned)(character - 'A') + 10u;
    return 16u;
}

/* Remove a correct checksum from the end of a line; false if it is missing or wrong. */
static bool without_checksum(const char *line, size_t *count)
{
    if (*count < CHECKSUM_BYTES || line[*count - 3] != '*')
        return false;
    const unsigned high = digit(line[*count - 2]), low = digit(line[*count - 1]);
    *count -= 3;
    if (high > 15u || low > 15u || crc_of(line, *count) != (high << 4 | low))
        return false;
    while (*count > 0 && line[*count - 1] == ' ')
        (*count)--;
    return true;
}

/* Read "100 21000022", with flags or without, behind "rcv ". */
static bool read_frame(const char *at, const char *end, struct can_frame_bytes *frame)
{
    uint64_t id = 0;
    size_t digits = 0;
    while (at < end && digit(*at) < 16u && digits <= 8) {
        id = id << 4 | digit(*at++);
        digits++;
    }
    if (digits == 0 || id >> 29 != 0 || at == end || *at++ != ' ')
        return false;
    size_t count = 0;
    while (at < end && *at != ' ') {
        if (count == CAN_FRAME_BYTES || end - at < 2 || digit(at[0]) > 15u || digit(at[1]) > 15u)
            return false;
        frame->bytes[count++] = (uint8_t)(digit(at[0]) << 4 | digit(at[1]));
        at += 2;
    }
    frame->id = (uint32_t)id;
    frame->count = (uint8_t)count;
    return true;
}

/* Return true if the line is a frame. */
static bool read_line(struct fdcanusb *port, struct can_frame_bytes *frame)
{
    size_t count = port->count;
    if (port->checksum && !without_checksum(port->line, &count)) {
        port->garbled++;
        return false;
    }
    if (count >= 4 && memcmp(port->line, "rcv ", 4) == 0 && read_frame(port->line + 4, port->line + count, frame))
        return true;
    if (count == 2 && memcmp(port->line, "OK", 2) == 0)
        port->sent++;
    else if (count >= 3 && memcmp(port->line, "ERR", 3) == 0)
        port->refused++;
    else
        port->garbled++;
    return false;
}

bool fdcanusb_take(struct fdcanusb *port, uint8_t byte, struct can_frame_bytes *frame)
{
    if (byte != '\r' && byte != '\n') {
        if (port->count == FDCANUSB_LINE_BYTES)
            port->overlong = true;
        else
            port->line[port->count++] = (char)byte;
        return false;
    }
    bool there = false;
    if (port->overlong)
        port->garbled++;
    else if (port->count > 0)
        there = read_line(port, frame);
    port->count = 0;
    port->overlong = false;
    return there;
}
