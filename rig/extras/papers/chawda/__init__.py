"""Reproduce Chawda, Celik and O'Malley 2011: velocity estimators."""
