"""Map walls: which walls are stable (Z-width), which impedances are passive, and where theory and hits differ."""
