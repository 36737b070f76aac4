"""Linear theory, impedance and identification: pure computations that take arrays and return numbers."""
