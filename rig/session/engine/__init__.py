"""A session that runs: its log, the state that follows from it, trials on a device, and the desk's interface."""
