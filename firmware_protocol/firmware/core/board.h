/* Constants of board and rig that the core needs. A port fills them in; the dictionary is generated. */
#ifndef HR_BOARD_H
#define HR_BOARD_H

#include <stddef.h>
#include <stdint.h>

/* A range narrower than the table's; bounds as on the wire. */
struct narrower {
    uint8_t parameter; /* enum hr_parameter_index */
    uint32_t minimum;
    uint32_t maximum;
};

/* The rig's mechanics, for the check that a large effort produces encoder edges. SI, rotary or linear. */
struct mechanics {
    double effort_quantum; /* N·m or N a quantum of current */
    double effort_limit;   /* of the amplifier */
    double friction;       /* and weight: what the effort must overcome */
    double travel;         /* two encoder counts */
    double inertia;
    double damping;
    double lag_s; /* of the amplifier */
};

/* Properties of the current sensor and of the amplifier, for the comparison of measured and set current. */
struct current_sensor {
    double noise;    /* of a measurement with quantisation, and the count's with back-EMF (quanta, rms); negative: no sensor */
    double lag_s;    /* between the current that is set and the one that flows */
    double delay_s;  /* of the set-point, before the lag */
    double back_emf; /* current that it takes off at a count a second (quanta·s); 0 for a current amplifier */
};

struct board {
    const uint8_t *dictionary; /* compressed, as IDENTIFY pages it */
    uint16_t dictionary_bytes;
    uint64_t dictionary_hash;
    uint32_t rate_initial;           /* ticks a second (Hz) until configured */
    const struct narrower *narrower; /* rising by parameter */
    size_t narrower_count;
    int8_t encoder_sign;   /* -1 when counts fall while the position rises */
    uint16_t over_current; /* a measured current above this is a fault (quanta) */
    struct mechanics mechanics;
    struct current_sensor current_sensor;
    int16_t *excitation;         /* memory for one period of an excitation; NULL: the device has none */
    uint32_t excitation_length;  /* its numbers */
};

#endif
