"""The simulated mechanics: motor, handle, hand, cogging and encoder, and the record of their true state."""
