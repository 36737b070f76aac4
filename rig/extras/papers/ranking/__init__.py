"""Rank velocity estimators and control laws on every preset, by the areas of stable, correctly rendered walls."""
