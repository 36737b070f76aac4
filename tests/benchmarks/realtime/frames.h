/* Frames of the link in C: COBS, CRC-32, COMMAND and STATE. MAJOR, COMMAND_TYPE, STATE_TYPE and STATE_RUNNING come from
   the compiler's command line, out of the Python modules. */
#ifndef FRAMES_H
#define FRAMES_H
#include <poll.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define HEADER 6
#define CRC 4
#define COMMAND_PAYLOAD 10
#define STATE_PAYLOAD 39
#define ROOM 64
#define MODE_STOP 2
#define NO_AGE 0xFFFF /* of the active COMMAND: nobody keeps it here */

static uint32_t crc_table[8][256];

static inline void crc_prepare(void)
{
    for (uint32_t byte = 0; byte < 256; byte++) {
        uint32_t rest = byte;
        for (int bit = 0; bit < 8; bit++)
            rest = (rest >> 1) ^ (rest & 1 ? 0xEDB88320u : 0);
        crc_table[0][byte] = rest;
    }
    for (int row = 1; row < 8; row++)
        for (int byte = 0; byte < 256; byte++)
            crc_table[row][byte] = (crc_table[row - 1][byte] >> 8) ^ crc_table[0][crc_table[row - 1][byte] & 0xFF];
}

static inline uint32_t crc32(const uint8_t *data, int size)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (; size >= 8; size -= 8, data += 8) {
        uint32_t low = crc ^ (data[0] | data[1] << 8 | data[2] << 16 | (uint32_t)data[3] << 24);
        crc = crc_table[7][low & 0xFF] ^ crc_table[6][(low >> 8) & 0xFF] ^ crc_table[5][(low >> 16) & 0xFF]
            ^ crc_table[4][low >> 24] ^ crc_table[3][data[4]] ^ crc_table[2][data[5]] ^ crc_table[1][data[6]]
            ^ crc_table[0][data[7]];
    }
    while (size-- > 0)
        crc = (crc >> 8) ^ crc_table[0][(crc ^ *data++) & 0xFF];
    return crc ^ 0xFFFFFFFFu;
}

static inline uint8_t *put(uint8_t *at, uint64_t value, int size)
{
    for (int k = 0; k < size; k++)
        *at++ = (uint8_t)(value >> (8 * k));
    return at;
}

static inline uint32_t get(const uint8_t *at, int size)
{
    uint32_t value = 0;
    for (int k = 0; k < size; k++)
        value |= (uint32_t)at[k] << (8 * k);
    return value;
}

/* Header in front of a payload that already stands at frame + 1 + HEADER, CRC behind it, stuffed in place; its size. */
static inline int seal(uint8_t *frame, int type, int session, int sequence, int payload)
{
    uint8_t *at = put(put(put(put(put(frame + 1, MAJOR, 1), type, 1), 0, 1), session, 1), sequence, 2);
    int end = 1 + HEADER + payload;
    (void)at;
    put(frame + end, crc32(frame + 1, end - 1), CRC);
    end += CRC;
    int code_at = 0;
    for (int i = 1; i < end; i++)
        if (frame[i] == 0) {
            frame[code_at] = (uint8_t)(i - code_at);
            code_at = i;
        }
    frame[code_at] = (uint8_t)(end - code_at);
    frame[end] = 0;
    return end + 1;
}

/* Undo the stuffing of `size` bytes without the delimiter: bytes of header and payload in `raw`, or -1. */
static inline int unseal(const uint8_t *frame, int size, uint8_t *raw)
{
    if (size < HEADER + CRC + 1 || size > ROOM - 2)
        return -1;
    int code_at = 0, next = frame[0];
    for (int i = 1; i < size; i++) {
        if (i == code_at + next) {
            code_at = i;
            next = frame[i];
            raw[i - 1] = 0;
        } else
            raw[i - 1] = frame[i];
    }
    int length = size - 1 - CRC;
    if (code_at + next != size || crc32(raw, length) != get(raw + length, CRC))
        return -1;
    return length;
}

static inline int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static inline int become_fifo(int priority)
{
    struct sched_param parameter = {.sched_priority = priority};
    return priority > 0 ? sched_setscheduler(0, SCHED_FIFO, &parameter) : 0;
}

#endif
