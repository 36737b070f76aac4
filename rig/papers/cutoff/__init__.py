"""Chawda, Celik and O'Malley on the cut-off of a velocity filter, as far as it could be read: its abstract."""
