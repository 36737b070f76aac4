"""Maps of walls: which walls are stable (Z-width), which impedances are passive, and how theory and hits differ."""
