"""The loop of a rig: compiled text (`host`) and the threads around it (`run`)."""
