"""Reproduce the comparison of velocity estimators by Chawda, Celik and O'Malley (2011)."""
