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

/* Return true if minimum <= value <= maximum, in the parameter's own type; no NaN is. */
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

static struct refusal refuse(enum hr_status status, uint16_t detail)
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

/* Entries rise by id, so the next one is behind the last one; a block that is out of order is searched whole. */
static size_t index_of(uint16_t id, size_t from)
{
    size_t index = hr_parameters[from].id <= id ? from : 0;
    while (index < HR_PARAMETERS && hr_parameters[index].id != id)
        index++;
    return index;
}

void configuration_begin(const struct configuration *configuration, struct candidate *candidate)
{
    memcpy(candidate->values, configuration->values, sizeof candidate->values);
    memset(candidate->given, 0, sizeof candidate->given);
    candidate->homes = false;
    candidate->previous = -1;
    candidate->index = 0;
}

struct refusal configuration_take(struct candidate *candidate, const uint8_t *entry)
{
    const uint16_t id = get_u16(entry);
    const uint32_t value = get_u32(entry + 2);
    const size_t index = index_of(id, candidate->index);
    if (index == HR_PARAMETERS)
        return refuse(HR_STATUS_UNKNOWN_PARAMETER, id);
    if (id <= candidate->previous)
        return refuse(HR_STATUS_BAD_ORDER, id);
    if (!is_in_table_range(&hr_parameters[index], value))
        return refuse(HR_STATUS_OUT_OF_RANGE, id);
    candidate->previous = id;
    candidate->index = index;
    /* One zero only: -0.0 would be another block with the same meaning. */
    const bool negative_zero = hr_parameters[index].kind == HR_FLOAT && value == NEGATIVE_ZERO;
    candidate->values[index] = negative_zero ? 0 : value;
    candidate->given[index] = true;
    return ACCEPTED;
}

/* Refuse a value inside the table's range but outside this board's. */
static struct refusal check_board(const struct board *board, const uint32_t *values, const bool *given)
{
    for (size_t i = 0; i < board->narrower_count; i++) {
        const struct narrower *narrower = &board->narrower[i];
        const struct hr_parameter *parameter = &hr_parameters[narrower->parameter];
        const uint32_t value = values[narrower->parameter];
        if (given[narrower->parameter]
            && !is_between((enum hr_kind)parameter->kind, narrower->minimum, value, narrower->maximum))
            return refuse(HR_STATUS_OUT_OF_RANGE, parameter->id);
    }
    return ACCEPTED;
}

static struct refusal check_together(const uint32_t *values)
{
    if (signed_32(values[HR_PARAMETER_WINDOW_MINIMUM]) > signed_32(values[HR_PARAMETER_WINDOW_MAXIMUM]))
        return refuse(HR_STATUS_INCONSISTENT, hr_parameters[HR_PARAMETER_WINDOW_MAXIMUM].id);
    return ACCEPTED;
}

/* Return the first given parameter that is not live, or HR_PARAMETERS. */
static size_t first_not_live(const bool *given)
{
    size_t index = 0;
    while (index < HR_PARAMETERS && (!given[index] || hr_parameters[index].live))
        index++;
    return index;
}

struct refusal configuration_check(struct candidate *candidate, const struct board *board, bool armed)
{
    const size_t grave = first_not_live(candidate->given);
    if (grave < HR_PARAMETERS && !candidate->given[HR_PARAMETER_VERIFIED])
        candidate->values[HR_PARAMETER_VERIFIED] = 0; /* unless the block sets it again */
    candidate->homes = candidate->given[HR_PARAMETER_REFERENCE_COUNT];
    const struct refusal refusal = check_board(board, candidate->values, candidate->given);
    if (refusal.status != HR_STATUS_OK)
        return refusal;
    if (armed && grave < HR_PARAMETERS)
        return refuse(HR_STATUS_NOT_LIVE, hr_parameters[grave].id);
    return check_together(candidate->values);
}

struct refusal configuration_read(const struct configuration *configuration, const struct board *board,
                                  const uint8_t *block, size_t count, struct candidate *candidate)
{
    configuration_begin(configuration, candidate);
    if (count % HR_PARAMETER_BYTES != 0)
        return refuse(HR_STATUS_BAD_LENGTH, 0);
    for (size_t at = 0; at < count; at += HR_PARAMETER_BYTES) {
        const struct refusal refusal = configuration_take(candidate, block + at);
        if (refusal.status != HR_STATUS_OK)
            return refusal;
    }
    return configuration_check(candidate, board, false);
}

void configuration_entry(const uint32_t *values, size_t index, uint8_t *entry)
{
    put_u16(entry, hr_parameters[index].id);
    put_u32(entry + 2, values[index]);
}

void configuration_put(struct configuration *configuration, const struct candidate *candidate, size_t index)
{
    configuration->values[index] = candidate->values[index];
    configuration_entry(candidate->values, index, configuration->block + index * HR_PARAMETER_BYTES);
}

void configuration_activate(struct configuration *configuration, const struct candidate *candidate)
{
    for (size_t i = 0; i < HR_PARAMETERS; i++)
        configuration_put(configuration, candidate, i);
    configuration->crc = crc_of(configuration->block, sizeof configuration->block);
    configuration->homed = configuration->homed || candidate->homes;
}
