/* The law against golden vectors, on the processor itself.
 *
 * A file, little-endian: "HRGOLD01", number of cases u32, bytes of struct law_parameters u32; for each case the
 * parameters, the phase in which it begins u32, number of ticks u32, and for each tick its law_input and what it must leave
 * (struct left). Exit code 0: all did; else the file "failure" says which tick of which case did not. */
#include <string.h>

#include "bytes.h"
#include "excitation.h"
#include "law.h"
#include "semihosting.h"
#include "tests.h"

#define MAGIC "HRGOLD01"
#define MAGIC_BYTES 8u
#define HEAD_BYTES 16u

#define EXCITATION_TICKS 65536u /* most that law_check lets pass */
#define COSINES_AT_ONCE 1000u

enum verdict { GOOD = 0, BAD_FILE = 3, BAD_PARAMETERS = 4, ANOTHER_ANSWER = 5 };

/* What a tick leaves behind. */
struct left {
    law_output out;
    float velocity, limited;
    int32_t velocity_fixed;
    uint32_t window;
};

struct line {
    law_input in;
    struct left expected;
};

static law_parameters parameters;
static law_state state;
static int16_t excitation[EXCITATION_TICKS];

static struct left one_tick(const law_input *in)
{
    struct left left;
    left.out = law_tick(&state, &parameters, in);
    left.velocity = state.velocity;
    left.limited = state.limited;
    left.velocity_fixed = state.velocity_fixed;
    left.window = state.window;
    return left;
}

static void work_out_excitation(void)
{
    law_excitation_work work;
    law_excitation_begin(&work, &parameters.excitation, excitation);
    while (!law_excitation_continue(&work, COSINES_AT_ONCE))
        continue;
}

/* Report what went wrong. */
static enum verdict told(uint32_t number, uint32_t tick, const struct left *left)
{
    uint8_t numbers[8];
    const int32_t file = semihosting_open_to_write("failure");
    put_u32(numbers, number);
    put_u32(numbers + 4, tick);
    semihosting_write(file, numbers, sizeof numbers);
    semihosting_write(file, (const uint8_t *)left, sizeof *left);
    return ANOTHER_ANSWER;
}

static enum verdict run_case(int32_t file, uint32_t number)
{
    uint8_t head[8];
    if (!semihosting_read(file, (uint8_t *)&parameters, sizeof parameters) || !semihosting_read(file, head, sizeof head))
        return BAD_FILE;
    if (law_check(&parameters) != LAW_GOOD)
        return BAD_PARAMETERS;
    work_out_excitation();
    law_reset(&state, &parameters, excitation);
    state.phase = get_u32(head);
    const uint32_t ticks = get_u32(head + 4);
    for (uint32_t tick = 0; tick < ticks; tick++) {
        struct line line;
        if (!semihosting_read(file, (uint8_t *)&line, sizeof line))
            return BAD_FILE;
        const struct left left = one_tick(&line.in);
        if (memcmp(&left, &line.expected, sizeof left) != 0)
            return told(number, tick, &left);
    }
    return GOOD;
}

uint32_t law_vectors(int32_t file)
{
    uint8_t head[HEAD_BYTES];
    if (!semihosting_read(file, head, sizeof head) || memcmp(head, MAGIC, MAGIC_BYTES) != 0
        || get_u32(head + MAGIC_BYTES + 4) != sizeof parameters)
        return BAD_FILE;
    const uint32_t cases = get_u32(head + MAGIC_BYTES);
    enum verdict verdict = GOOD;
    for (uint32_t number = 0; number < cases && verdict == GOOD; number++)
        verdict = run_case(file, number);
    return verdict;
}
