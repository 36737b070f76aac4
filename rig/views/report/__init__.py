"""Reports: one HTML file that holds everything, to be read on a phone, printed, mailed and kept for years."""
