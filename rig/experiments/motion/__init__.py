"""Motions without a wall: torque pulses that check the motor, the search for the reference, and weighing."""
