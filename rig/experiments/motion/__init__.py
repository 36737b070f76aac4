"""Motions without a wall: pushes, strokes and pulses that identify, find the reference, and prove the motor."""
