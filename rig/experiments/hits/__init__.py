"""Hits on a rig, real or simulated: check that a hit is permitted, run it, judge it, and compare schemes."""
