/* The fault that is latched, those that came later, and the ticks before the first. */
#ifndef HR_FAULTS_H
#define HR_FAULTS_H

#include <stdbool.h>
#include <stdint.h>

#include "protocol.h"

#define HR_RING_TICKS 256u

struct fault_entry {
    uint32_t sample_index;
    int32_t count;
    int16_t current_commanded;
    int16_t current_measured;
    uint16_t limits;
};

struct fault_ring {
    uint16_t next;
    uint16_t count;
    struct fault_entry entries[HR_RING_TICKS];
};

struct faults {
    uint8_t latched; /* enum hr_fault: first since the last clear, or NONE */
    uint8_t first;   /* kept after the clear, for the log */
    uint32_t later;  /* bits 1 << code */
    uint64_t time;   /* device time of the first */
    struct fault_ring live;
    struct fault_ring frozen; /* ring of a cleared fault, until the next fault */
};

void faults_reset(struct faults *faults);

/* Store a tick in the ring. The tick must have begun before a fault was latched. */
void faults_remember(struct faults *faults, const struct fault_entry *entry);

/* Latch faults, given as bits 1 << code, at least one. If none is latched yet, the gravest becomes the first. */
void faults_latch(struct faults *faults, uint32_t bits, uint64_t time);

/* Clear the latched fault. */
void faults_clear(struct faults *faults);

/* Return the ring that a host may read: of the latched fault, else of the last fault. */
const struct fault_ring *faults_log(const struct faults *faults);

/* Copy entry `number` of a ring (0: the oldest) as on the wire, HR_FAULT_ENTRY_BYTES long. */
void fault_ring_read(const struct fault_ring *ring, uint16_t number, uint8_t *into);

#endif
