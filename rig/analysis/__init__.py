"""Analyse haptic rigs with arrays alone: linear theory, impedance and identification, without devices or files."""
