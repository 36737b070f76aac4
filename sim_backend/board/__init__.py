"""The simulated board: the device that speaks the protocol for the mechanics, in Python and as the C firmware."""
