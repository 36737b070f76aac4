"""Which rates, estimator and filter suit a rig: a search through a listed set of schemes, for stated wishes.

* `rules`: what is measured, and what best, no worse and margin mean; written before any result
"""
