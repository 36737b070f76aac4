"""Maps of walls: Z-width, impedance, and where theory and hits differ."""
