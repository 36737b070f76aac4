"""Compute one tick of the controller, and the verdict of a trial; numbers only, no devices and no files."""
