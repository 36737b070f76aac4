#include "faults.h"

#include <string.h>

#include "bytes.h"

/* Faults found in one tick, gravest first; then those with the lowest code. */
static const uint8_t GRAVITY[] = {
    HR_FAULT_EMERGENCY_STOP, HR_FAULT_OVER_CURRENT,    HR_FAULT_CURRENT_MISMATCH, HR_FAULT_RUNAWAY,
    HR_FAULT_OVER_SPEED,     HR_FAULT_POSITION_WINDOW, HR_FAULT_THERMAL,
};

static uint8_t gravest(uint32_t bits)
{
    for (size_t i = 0; i < sizeof GRAVITY; i++)
        if (bits & UINT32_C(1) << GRAVITY[i])
            return GRAVITY[i];
    uint8_t code = 0;
    while (!(bits & UINT32_C(1) << code))
        code++;
    return code;
}

void faults_reset(struct faults *faults)
{
    memset(faults, 0, sizeof *faults);
}

void faults_remember(struct faults *faults, const struct fault_entry *entry)
{
    struct fault_ring *ring = &faults->live;
    ring->entries[ring->next] = *entry;
    ring->next = (uint16_t)((ring->next + 1u) % HR_RING_TICKS);
    if (ring->count < HR_RING_TICKS)
        ring->count++;
}

void faults_latch(struct faults *faults, uint32_t bits, uint64_t time)
{
    if (faults->latched == HR_FAULT_NONE) {
        faults->latched = gravest(bits);
        faults->first = faults->latched;
        faults->later = 0;
        faults->time = time;
    }
    faults->later |= bits & ~(UINT32_C(1) << faults->first);
}

/* The copy takes one or two ticks, so it is made here, with the amplifier off, and not in the tick of the fault. */
void faults_clear(struct faults *faults)
{
    if (faults->latched != HR_FAULT_NONE)
        faults->frozen = faults->live;
    faults->latched = HR_FAULT_NONE;
}

const struct fault_ring *faults_log(const struct faults *faults)
{
    return faults->latched != HR_FAULT_NONE ? &faults->live : &faults->frozen;
}

void fault_ring_read(const struct fault_ring *ring, uint16_t number, uint8_t *into)
{
    const size_t oldest = ring->count < HR_RING_TICKS ? 0u : ring->next;
    const struct fault_entry *entry = &ring->entries[(oldest + number) % HR_RING_TICKS];
    put_u32(into + HR_AT_FAULT_ENTRY_SAMPLE_INDEX, entry->sample_index);
    put_u32(into + HR_AT_FAULT_ENTRY_COUNT, (uint32_t)entry->count);
    put_u16(into + HR_AT_FAULT_ENTRY_CURRENT_COMMANDED, (uint16_t)entry->current_commanded);
    put_u16(into + HR_AT_FAULT_ENTRY_CURRENT_MEASURED, (uint16_t)entry->current_measured);
    put_u16(into + HR_AT_FAULT_ENTRY_LIMITS, entry->limits);
}
