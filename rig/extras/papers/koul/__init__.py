"""Reproduce Koul, Saha and Manivannan 2013: dual-rate sampling."""
