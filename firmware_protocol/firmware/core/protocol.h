/* Made by `python -m firmware_protocol.codegen` from the tables that run: do not edit. */
#ifndef HR_PROTOCOL_H
#define HR_PROTOCOL_H

#include <stdint.h>

#define HR_MAJOR 1u
#define HR_MINOR 0u
#define HR_TIME_UNITS_PER_US 16u /* of device time */
#define HR_HEADER_BYTES 6u
#define HR_CRC_BYTES 4u
#define HR_SHORT_RAW_LIMIT 60u /* raw frame with its CRC, but for BATCH */
#define HR_RAW_LIMIT 252u /* BATCH */
#define HR_RAW_MINIMUM 10u
#define HR_ENCODED_LIMIT 253u /* stuffed, without the delimiter */
#define HR_NO_COMMAND_YET 65535u /* STATE.command_age */
#define HR_OLDEST_EDGE 2147483647u /* age at which STATE.edge_time saturates */
#define HR_TRANSACTION_END 64u /* type ids below are answered */
#define HR_DEVICE_BIT 1u /* of a type id: sent by the device */
#define HR_BLOCK_LIMIT 1024u /* bytes of a parameter block */
#define HR_PARAMETER_BYTES 6u /* an entry of a block: id, value */
#define HR_FAULT_ENTRY_BYTES 14u

enum hr_type {
    HR_TYPE_IDENTIFY = 0x00,
    HR_TYPE_IDENTITY = 0x01,
    HR_TYPE_ACK = 0x03,
    HR_TYPE_SET_BEGIN = 0x04,
    HR_TYPE_SET_CHUNK = 0x06,
    HR_TYPE_SET_COMMIT = 0x08,
    HR_TYPE_GET_PARAMETERS = 0x0A,
    HR_TYPE_PARAMETERS = 0x0B,
    HR_TYPE_ARM = 0x0C,
    HR_TYPE_DISARM = 0x0E,
    HR_TYPE_GET_TIME = 0x10,
    HR_TYPE_TIME = 0x11,
    HR_TYPE_GET_FAULT_LOG = 0x12,
    HR_TYPE_FAULT_LOG = 0x13,
    HR_TYPE_GET_STATISTICS = 0x14,
    HR_TYPE_STATISTICS = 0x15,
    HR_TYPE_COMMAND = 0x40,
    HR_TYPE_STATE = 0x41,
    HR_TYPE_BATCH = 0x61,
};

/* Where a message lies in hr_messages. */
enum hr_index {
    HR_INDEX_IDENTIFY,
    HR_INDEX_IDENTITY,
    HR_INDEX_ACK,
    HR_INDEX_SET_BEGIN,
    HR_INDEX_SET_CHUNK,
    HR_INDEX_SET_COMMIT,
    HR_INDEX_GET_PARAMETERS,
    HR_INDEX_PARAMETERS,
    HR_INDEX_ARM,
    HR_INDEX_DISARM,
    HR_INDEX_GET_TIME,
    HR_INDEX_TIME,
    HR_INDEX_GET_FAULT_LOG,
    HR_INDEX_FAULT_LOG,
    HR_INDEX_GET_STATISTICS,
    HR_INDEX_STATISTICS,
    HR_INDEX_COMMAND,
    HR_INDEX_STATE,
    HR_INDEX_BATCH,
    HR_MESSAGES
};

/* HR_AT_…: offset in the raw frame. HR_BYTES_…: header and fixed fields. */
#define HR_AT_HEADER_MAJOR 0u /* u8 */
#define HR_AT_HEADER_TYPE_ID 1u /* u8 */
#define HR_AT_HEADER_FLAGS 2u /* u8 */
#define HR_AT_HEADER_SESSION 3u /* u8 */
#define HR_AT_HEADER_SEQUENCE 4u /* u16 */

#define HR_AT_IDENTIFY_NONCE 6u /* u16 */
#define HR_AT_IDENTIFY_OFFSET 8u /* u16, byte */
#define HR_BYTES_IDENTIFY 10u

#define HR_AT_IDENTITY_NONCE 6u /* u16 */
#define HR_AT_IDENTITY_MINOR 8u /* u8 */
#define HR_AT_IDENTITY_STATE 9u /* u8 */
#define HR_AT_IDENTITY_DICTIONARY_HASH 10u /* u64 */
#define HR_AT_IDENTITY_TOTAL 18u /* u16, byte */
#define HR_AT_IDENTITY_OFFSET 20u /* u16, byte */
#define HR_AT_IDENTITY_DATA 22u /* bytes */
#define HR_BYTES_IDENTITY 22u
#define HR_DATA_LIMIT_IDENTITY 34u /* bytes of data */

#define HR_AT_ACK_NONCE 6u /* u16 */
#define HR_AT_ACK_REQUEST 8u /* u8 */
#define HR_AT_ACK_STATUS 9u /* u8 */
#define HR_AT_ACK_DETAIL 10u /* u16 */
#define HR_AT_ACK_SAMPLE_INDEX 12u /* u32, tick */
#define HR_AT_ACK_CRC 16u /* u32 */
#define HR_BYTES_ACK 20u

#define HR_AT_SET_BEGIN_NONCE 6u /* u16 */
#define HR_AT_SET_BEGIN_LENGTH 8u /* u16, byte */
#define HR_AT_SET_BEGIN_CRC 10u /* u32 */
#define HR_BYTES_SET_BEGIN 14u

#define HR_AT_SET_CHUNK_NONCE 6u /* u16 */
#define HR_AT_SET_CHUNK_OFFSET 8u /* u16, byte */
#define HR_AT_SET_CHUNK_DATA 10u /* bytes */
#define HR_BYTES_SET_CHUNK 10u
#define HR_DATA_LIMIT_SET_CHUNK 46u /* bytes of data */

#define HR_AT_SET_COMMIT_NONCE 6u /* u16 */
#define HR_BYTES_SET_COMMIT 8u

#define HR_AT_GET_PARAMETERS_NONCE 6u /* u16 */
#define HR_AT_GET_PARAMETERS_OFFSET 8u /* u16, byte */
#define HR_BYTES_GET_PARAMETERS 10u

#define HR_AT_PARAMETERS_NONCE 6u /* u16 */
#define HR_AT_PARAMETERS_TOTAL 8u /* u16, byte */
#define HR_AT_PARAMETERS_CRC 10u /* u32 */
#define HR_AT_PARAMETERS_OFFSET 14u /* u16, byte */
#define HR_AT_PARAMETERS_DATA 16u /* bytes */
#define HR_BYTES_PARAMETERS 16u
#define HR_DATA_LIMIT_PARAMETERS 40u /* bytes of data */

#define HR_AT_ARM_NONCE 6u /* u16 */
#define HR_AT_ARM_DICTIONARY_HASH 8u /* u64 */
#define HR_AT_ARM_PARAMETERS_CRC 16u /* u32 */
#define HR_BYTES_ARM 20u

#define HR_AT_DISARM_NONCE 6u /* u16 */
#define HR_AT_DISARM_FLAGS 8u /* u8 */
#define HR_BYTES_DISARM 9u

#define HR_AT_GET_TIME_NONCE 6u /* u16 */
#define HR_AT_GET_TIME_HOST_SENT 8u /* u64, ns */
#define HR_BYTES_GET_TIME 16u

#define HR_AT_TIME_NONCE 6u /* u16 */
#define HR_AT_TIME_HOST_SENT 8u /* u64, ns */
#define HR_AT_TIME_DEVICE_RECEIVED 16u /* u64, 1/16 µs */
#define HR_AT_TIME_DEVICE_SENT 24u /* u64, 1/16 µs */
#define HR_BYTES_TIME 32u

#define HR_AT_GET_FAULT_LOG_NONCE 6u /* u16 */
#define HR_AT_GET_FAULT_LOG_FIRST 8u /* u16 */
#define HR_BYTES_GET_FAULT_LOG 10u

#define HR_AT_FAULT_LOG_NONCE 6u /* u16 */
#define HR_AT_FAULT_LOG_FAULT 8u /* u16 */
#define HR_AT_FAULT_LOG_LATER 10u /* u32 */
#define HR_AT_FAULT_LOG_DEVICE_TIME 14u /* u64, 1/16 µs */
#define HR_AT_FAULT_LOG_TOTAL 22u /* u16 */
#define HR_AT_FAULT_LOG_FIRST 24u /* u16 */
#define HR_AT_FAULT_LOG_DATA 26u /* bytes */
#define HR_BYTES_FAULT_LOG 26u
#define HR_DATA_LIMIT_FAULT_LOG 30u /* bytes of data */

#define HR_AT_GET_STATISTICS_NONCE 6u /* u16 */
#define HR_BYTES_GET_STATISTICS 8u

#define HR_AT_STATISTICS_NONCE 6u /* u16 */
#define HR_AT_STATISTICS_FRAMES 8u /* u32 */
#define HR_AT_STATISTICS_FRAMING_ERRORS 12u /* u32 */
#define HR_AT_STATISTICS_CRC_ERRORS 16u /* u32 */
#define HR_AT_STATISTICS_MALFORMED 20u /* u32 */
#define HR_AT_STATISTICS_UNKNOWN_TYPE 24u /* u32 */
#define HR_AT_STATISTICS_FOREIGN_MAJOR 28u /* u32 */
#define HR_AT_STATISTICS_STALE_SESSION 32u /* u32 */
#define HR_AT_STATISTICS_OUT_OF_STATE 36u /* u32 */
#define HR_AT_STATISTICS_LOST 40u /* u32 */
#define HR_AT_STATISTICS_DUPLICATED 44u /* u32 */
#define HR_AT_STATISTICS_REORDERED 48u /* u32 */
#define HR_BYTES_STATISTICS 52u

#define HR_AT_COMMAND_STATE_SEQUENCE 6u /* u16 */
#define HR_AT_COMMAND_LIFETIME_US 8u /* u32, µs */
#define HR_AT_COMMAND_MODE 12u /* u8 */
#define HR_AT_COMMAND_FLAGS 13u /* u8 */
#define HR_AT_COMMAND_CURRENT 14u /* i16, quantum */
#define HR_BYTES_COMMAND 16u

#define HR_AT_STATE_COMMAND_SEQUENCE 6u /* u16 */
#define HR_AT_STATE_COMMAND_AGE 8u /* u16, tick */
#define HR_AT_STATE_SAMPLE_INDEX 10u /* u32, tick */
#define HR_AT_STATE_DEVICE_TIME 14u /* u32, 1/16 µs */
#define HR_AT_STATE_COUNT 18u /* i32, count */
#define HR_AT_STATE_EDGE_TIME 22u /* u32, 1/16 µs */
#define HR_AT_STATE_CURRENT_MEASURED 26u /* i16, quantum */
#define HR_AT_STATE_CURRENT_COMMANDED 28u /* i16, quantum */
#define HR_AT_STATE_LIMITS 30u /* u16 */
#define HR_AT_STATE_FAULT 32u /* u16 */
#define HR_AT_STATE_EXECUTION_TIME 34u /* u16, 1/16 µs */
#define HR_AT_STATE_MISSED_TICKS 36u /* u16, tick */
#define HR_AT_STATE_STATE 38u /* u8 */
#define HR_AT_STATE_INPUTS 39u /* u8 */
#define HR_BYTES_STATE 40u

#define HR_AT_BATCH_FIRST_INDEX 6u /* u32, tick */
#define HR_AT_BATCH_DEVICE_TIME 10u /* u32, 1/16 µs */
#define HR_AT_BATCH_BASE_COUNT 14u /* i32, count */
#define HR_AT_BATCH_LAYOUT 18u /* u8 */
#define HR_AT_BATCH_SAMPLES 19u /* u8 */
#define HR_AT_BATCH_DATA 20u /* bytes */
#define HR_BYTES_BATCH 20u
#define HR_DATA_LIMIT_BATCH 228u /* bytes of data */

/* In an entry of FAULT_LOG. */
#define HR_AT_FAULT_ENTRY_SAMPLE_INDEX 0u /* u32, tick */
#define HR_AT_FAULT_ENTRY_COUNT 4u /* i32, count */
#define HR_AT_FAULT_ENTRY_CURRENT_COMMANDED 8u /* i16, quantum */
#define HR_AT_FAULT_ENTRY_CURRENT_MEASURED 10u /* i16, quantum */
#define HR_AT_FAULT_ENTRY_LIMITS 12u /* u16 */

enum hr_state {
    HR_STATE_BOOT = 0,
    HR_STATE_IDENTIFIED = 1,
    HR_STATE_CONFIGURED = 2,
    HR_STATE_ARMED = 3,
    HR_STATE_RUNNING = 4,
    HR_STATE_FAULT = 5,
};

enum hr_fault {
    HR_FAULT_NONE = 0,
    HR_FAULT_LINK_LOST = 1,
    HR_FAULT_OVER_SPEED = 2,
    HR_FAULT_OVER_CURRENT = 3,
    HR_FAULT_NON_FINITE = 4,
    HR_FAULT_ENCODER = 5,
    HR_FAULT_TICK_OVERRUN = 6,
    HR_FAULT_EMERGENCY_STOP = 7,
    HR_FAULT_POSITION_WINDOW = 8,
    HR_FAULT_THERMAL = 9,
    HR_FAULT_RUNAWAY = 10,
    HR_FAULT_WATCHDOG_RESET = 11,
    HR_FAULT_INTERNAL = 12,
    HR_FAULT_BATCH_OVERFLOW = 13,
};

enum hr_limit {
    HR_LIMIT_CURRENT = 1,
    HR_LIMIT_SLEW = 2,
    HR_LIMIT_SPEED = 4,
    HR_LIMIT_POSITION = 8,
    HR_LIMIT_THERMAL = 16,
    HR_LIMIT_RAMPING = 32,
    HR_LIMIT_HOLD_TO_RUN_RELEASED = 64,
};

enum hr_status {
    HR_STATUS_OK = 0,
    HR_STATUS_UNSUPPORTED = 1,
    HR_STATUS_BAD_STATE = 2,
    HR_STATUS_UNKNOWN_PARAMETER = 3,
    HR_STATUS_OUT_OF_RANGE = 4,
    HR_STATUS_BAD_LENGTH = 5,
    HR_STATUS_BAD_CRC = 6,
    HR_STATUS_HASH_MISMATCH = 7,
    HR_STATUS_STALE_SESSION = 8,
    HR_STATUS_NOT_HOMED = 9,
    HR_STATUS_NOT_VERIFIED = 10,
    HR_STATUS_FAULT_LATCHED = 11,
    HR_STATUS_INCOMPLETE = 12,
    HR_STATUS_BAD_ORDER = 13,
    HR_STATUS_FAULT_PRESENT = 14,
    HR_STATUS_INCONSISTENT = 15,
};

enum hr_input {
    HR_INPUT_EMERGENCY_STOP = 1,
    HR_INPUT_HOLD_TO_RUN = 2,
};

enum hr_mode {
    HR_MODE_CURRENT = 0,
    HR_MODE_SUPERVISE = 1,
    HR_MODE_STOP = 2,
};

enum hr_disarm {
    HR_DISARM_CLEAR_FAULT = 1,
};

#define HR_STATES 6u
#define HR_NO_TRANSITION 255u

/* Where a parameter lies in hr_parameters. */
enum hr_parameter_index {
    HR_PARAMETER_MOTION,
    HR_PARAMETER_POSITION_RATE,
    HR_PARAMETER_VELOCITY_DIVIDER,
    HR_PARAMETER_STIFFNESS,
    HR_PARAMETER_DAMPING,
    HR_PARAMETER_WALL_POSITION,
    HR_PARAMETER_WALL_SIDE,
    HR_PARAMETER_WALL_PULL,
    HR_PARAMETER_REFERENCE_COUNT,
    HR_PARAMETER_VERIFIED,
    HR_PARAMETER_COMMAND_LIFETIME_US,
    HR_PARAMETER_RAMP_US,
    HR_PARAMETER_CURRENT_LIMIT,
    HR_PARAMETER_SLEW_LIMIT,
    HR_PARAMETER_SPEED_LIMIT,
    HR_PARAMETER_WINDOW_MINIMUM,
    HR_PARAMETER_WINDOW_MAXIMUM,
    HR_PARAMETER_CONTINUOUS_CURRENT,
    HR_PARAMETER_THERMAL_TIME_CONSTANT,
    HR_PARAMETER_HOLD_TO_RUN,
    HR_PARAMETER_SUPERVISE_LIFETIME_US,
    HR_PARAMETERS
};

struct hr_message {
    uint8_t type;
    uint8_t bytes;      /* header and fixed fields */
    uint8_t limit;      /* longest raw frame without its CRC */
    uint8_t remembered; /* a repeat gets the same answer and is not executed again */
};

/* How the four bytes of a value are read. */
enum hr_kind {
    HR_UNSIGNED,
    HR_SIGNED,
    HR_FLOAT,
};

struct hr_parameter {
    uint16_t id;
    uint8_t kind;        /* enum hr_kind */
    uint8_t excludes;    /* whether there is a value inside the range that is not allowed */
    uint32_t minimum;    /* these four as on the wire */
    uint32_t maximum;
    uint32_t initial;
    uint32_t excluded;
};

extern const struct hr_message hr_messages[HR_MESSAGES];
extern const struct hr_parameter hr_parameters[HR_PARAMETERS]; /* rising by id */

/* State × message → state after it, or HR_NO_TRANSITION: refused. */
extern const uint8_t hr_transitions[HR_STATES][HR_MESSAGES];

/* One byte of CRC-32/ISO-HDLC. */
extern const uint32_t hr_crc_table[256];

#endif
