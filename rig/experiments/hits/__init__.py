"""Check that a hit on a real or simulated rig is permitted, run it, judge it, and compare sampling schemes."""
