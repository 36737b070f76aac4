"""Velocity estimators over one signal: compared, tuned, exported."""
