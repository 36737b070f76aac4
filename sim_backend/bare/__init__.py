"""Simulate mechanics and control law together in one compiled call, without a byte link: trials, hits, excited rigs."""
