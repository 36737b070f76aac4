"""Compare velocity estimators on encoder counts, tune their settings, and export them as C."""
