"""The engine of a session: log, state computed from the log, trials on a device, interface to the operator."""
