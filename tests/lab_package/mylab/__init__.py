"""Walls and velocity estimators of our lab."""
