"""Optional parts: each folder uses the core, and the core runs without it."""
