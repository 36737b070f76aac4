#include "configuration.h"

#include <string.h>

#include "bytes.h"
#include "frame.h"

#define NEGATIVE_ZERO 0x80000000u

static const struct refusal ACCEPTED = {HR_STATUS_OK, 0};

float value_as_float(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Whether minimum <= value <= maximum, in the parameter's own type; no NaN is. */
static bool is_between(enum hr_kind kind, uint32_t minimum, uint32_t value, uint32_t maximum)
{
    switch (kind) {
    case HR_SIGNED:
        return signed_32(minimum) <= signed_32(value) && signed_32(value) <= signed_32(maximum);
    case HR_FLOAT:
        return value_as_float(minimum) <= value_as_float(value) && value_as_float(value) <= value_as_float(maximum);
    case HR_UNSIGNED:
    default:
        return minimum <= value && value <= maximum;
    }
}

static bool is_in_table_range(const struct hr_parameter *parameter, uint32_t value)
{
    if (parameter->excludes && value == parameter->excluded)
        return false;
    return is_between((enum hr_kind)parameter->kind, parameter->minimum, value, parameter->maximum);
}

static struct refusal refused(enum hr_status status, uint16_t detail)
{
    const struct refusal refusal = {status, detail};
    return refusal;
}

void configuration_initial(const struct board *board, struct candidate *candidate)
{
    candidate->homes = false;
    for (size_t i = 0; i < HR_PARAMETERS; i++)
        candidate->values[i] = hr_parameters[i].initial;
    candidate->values[HR_PARAMETER_POSITION_RATE] = board->rate_initial;
    for (size_t i = 0; i < board->narrower_count; i++) {
        const struct narrower *narrower = &board->narrower[i];
        const enum hr_kind kind = (enum hr_kind)hr_parameters[narrower->parameter].kind;
        uint32_t *value = &candidate->values[narrower->parameter];
        if (!is_between(kind, narrower->minimum, *value, narrower->maximum))
            *value = is_between(kind, *value, narrower->minimum, narrower->maximum) ? narrower->minimum
                                                                                    : narrower->maximum;
    }
}

static size_t index_of(uint16_t id)
{
    size_t index = 0;
    while (index < HR_PARAMETERS && hr_parameters[index].id != id)
        index++;
    return index;
}

/* Read the entries into `values`, and note which were `given`. */
static struct refusal read_entries(const uint8_t *block, size_t count, uint32_t *values, bool *given)
{
    int32_t previous = -1;
    for (size_t at = 0; at < count; at += HR_PARAMETER_BYTES) {
        const uint16_t id = get_u16(block + at);
        const uint32_t value = get_u32(block + at + 2);
        const size_t index = index_of(id);
        if (index == HR_PARAMETERS)
            return refused(HR_STATUS_UNKNOWN_PARAMETER, id);
        if (id <= previous)
            return refused(HR_STATUS_BAD_ORDER, id);
        if (!is_in_table_range(&hr_parameters[index], value))
            return refused(HR_STATUS_OUT_OF_RANGE, id);
        previous = id;
        /* One zero only: -0.0 would be another block with the same meaning. */
        const bool negative_zero = hr_parameters[index].kind == HR_FLOAT && value == NEGATIVE_ZERO;
        values[index] = negative_zero ? 0 : value;
        given[index] = true;
    }
    return ACCEPTED;
}

/* Refuse what is inside the table's range and outside this board's. */
static struct refusal check_board(const struct board *board, const uint32_t *values, const bool *given)
{
    for (size_t i = 0; i < board->narrower_count; i++) {
        const struct narrower *narrower = &board->narrower[i];
        const struct hr_parameter *parameter = &hr_parameters[narrower->parameter];
        const uint32_t value = values[narrower->parameter];
        if (given[narrower->parameter]
            && !is_between((enum hr_kind)parameter->kind, narrower->minimum, value, narrower->maximum))
            return refused(HR_STATUS_OUT_OF_RANGE, parameter->id);
    }
    return ACCEPTED;
}

static struct refusal check_together(const uint32_t *values)
{
    if (signed_32(values[HR_PARAMETER_WINDOW_MINIMUM]) > signed_32(values[HR_PARAMETER_WINDOW_MAXIMUM]))
        return refused(HR_STATUS_INCONSISTENT, hr_parameters[HR_PARAMETER_WINDOW_MAXIMUM].id);
    return ACCEPTED;
}

/* The first parameter of those given that is not live, or HR_PARAMETERS. */
static size_t first_not_live(const bool *given)
{
    size_t index = 0;
    while (index < HR_PARAMETERS && (!given[index] || hr_parameters[index].live))
        index++;
    return index;
}

struct refusal configuration_read(const struct configuration *configuration, const struct board *board, bool armed,
                                  const uint8_t *block, size_t count, struct candidate *candidate)
{
    bool given[HR_PARAMETERS] = {false};
    if (count % HR_PARAMETER_BYTES != 0)
        return refused(HR_STATUS_BAD_LENGTH, 0);
    memcpy(candidate->values, configuration->values, sizeof candidate->values);
    struct refusal refusal = read_entries(block, count, candidate->values, given);
    const size_t grave = first_not_live(given);
    if (grave < HR_PARAMETERS && !given[HR_PARAMETER_VERIFIED])
        candidate->values[HR_PARAMETER_VERIFIED] = 0; /* unless the block says it again */
    if (refusal.status == HR_STATUS_OK)
        refusal = check_board(board, candidate->values, given);
    if (refusal.status == HR_STATUS_OK && armed && grave < HR_PARAMETERS)
        refusal = refused(HR_STATUS_NOT_LIVE, hr_parameters[grave].id);
    if (refusal.status == HR_STATUS_OK)
        refusal = check_together(candidate->values);
    candidate->homes = given[HR_PARAMETER_REFERENCE_COUNT];
    return refusal;
}

void configuration_put_in_force(struct configuration *configuration, const struct candidate *candidate)
{
    memcpy(configuration->values, candidate->values, sizeof configuration->values);
    for (size_t i = 0; i < HR_PARAMETERS; i++) {
        uint8_t *entry = configuration->block + i * HR_PARAMETER_BYTES;
        put_u16(entry, hr_parameters[i].id);
        put_u32(entry + 2, candidate->values[i]);
    }
    configuration->crc = crc_of(configuration->block, sizeof configuration->block);
    configuration->homed = configuration->homed || candidate->homes;
}
