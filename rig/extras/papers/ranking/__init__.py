"""Rank pairs of estimator and law on every preset, by the rule of ``rig/decisions/0019``."""
