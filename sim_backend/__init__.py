"""The simulated rig: plant, sensors, a device that speaks the wire protocol, and its links."""
