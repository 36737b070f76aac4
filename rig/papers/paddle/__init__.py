"""Measured K–B curves of a paddle under four estimators, against every rig that could have given them."""
