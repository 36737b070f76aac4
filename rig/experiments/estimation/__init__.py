"""Velocity estimators on a signal of counts: compare them, tune their settings, and export them as C."""
