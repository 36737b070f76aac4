/* Commands to an ODrive and its messages, in CAN Simple, firmware 0.6.
 *
 * The bridge sends only states, modes and torques. It is not known which of them feeds the drive's watchdog; silence does
 * not. The drive sends by itself, on its own clock; a sample is a position and the torques of the same period. Messages
 * have no number, so an old one differs from a new one only by its arrival time.
 *
 * Source: the description of the messages of 0.6.10 (DBC) that the package odrive-can carries; odriverobotics/ODriveArduino
 * at f52eef5, src/can_simple_messages.hpp and ODriveEnums.h, opened. */
#ifndef HR_ODRIVE_H
#define HR_ODRIVE_H

#include "drive.h"

extern const struct drive_kind odrive_kind;

#endif
