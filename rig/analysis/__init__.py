"""Linear theory, impedance, identification: arrays in, numbers out."""
