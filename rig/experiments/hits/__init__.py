"""Hits on a rig, recorded or simulated: admitted, run, judged, compared."""
