"""The simulated board: a device that speaks the wire protocol, in Python and as the compiled C firmware."""
