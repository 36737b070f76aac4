"""The simulated rig: mechanics, sensors, a device that speaks the wire protocol, simulated drives, and their links."""
