"""Linear theory, impedance and identification of rigs: pure computations with arrays, without a device or a file."""
