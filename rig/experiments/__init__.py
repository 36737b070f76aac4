"""Experiments on a rig, each a function with plain arguments and a typed result; sweeps of them."""
