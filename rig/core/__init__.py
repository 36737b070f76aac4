"""Definitions shared by all rooms: errors, quantities, the columns of a sample, the model of a rig."""
