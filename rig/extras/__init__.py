"""Extras: each folder stands beside the core, which runs without it."""
