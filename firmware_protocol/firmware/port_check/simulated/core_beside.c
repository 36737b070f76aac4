/* The port check linked beside the core, with its entries under other names. */
#define device_start port_check_start
#define device_was_reset port_check_was_reset
#define device_is_armed port_check_is_armed
#define device_fault port_check_fault
#define device_tick port_check_tick
#define device_poll port_check_poll
#include "../port_check.c"
