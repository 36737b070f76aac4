/* Commands to an ODrive and its messages, in CAN Simple, firmware 0.6.
 *
 * It is told nothing but states, modes and torques: whichever message feeds its watchdog, silence does not. What it tells
 * comes by itself, by its own clock; a sample is a position and the torques of the same period. No message has a number, so
 * an old one differs from a new one only by its arrival time.
 *
 * Source: the description of the messages of 0.6.10 (DBC) that the package odrive-can carries; odriverobotics/ODriveArduino
 * at f52eef5, src/can_simple_messages.hpp and ODriveEnums.h, opened. */
#ifndef HR_ODRIVE_H
#define HR_ODRIVE_H

#include "drive.h"

extern const struct drive_kind odrive_kind;

#endif
