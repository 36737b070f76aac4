"""Move a rig without a wall: torque pulses that check the motor, search for position zero, and weighing."""
