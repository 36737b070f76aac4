"""Identification of a rig from motions: inertia, friction, ripple."""
