"""Reproduce the paper of Koul, Saha and Manivannan (2013) on dual-rate sampling."""
