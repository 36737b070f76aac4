"""Identify a rig from its motions: inertia, friction, damping, delay, cogging and torque ripple."""
