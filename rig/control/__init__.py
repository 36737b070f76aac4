"""Everything inside one tick, and the verdict on it; numbers only."""
