"""What a lab does with a rig, each a function with plain arguments and a typed result; sweeps."""
