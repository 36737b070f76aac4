"""Run experiments on a rig: each is a function with typed arguments and a typed result; sweeps run many of them."""
