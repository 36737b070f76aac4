"""Definitions that all packages of `rig` share: errors, quantities, the columns of a sample, the model of a rig."""
