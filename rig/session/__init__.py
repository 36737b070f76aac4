"""Sessions of one participant or one automated experiment: what was decided, and how it goes on after a crash."""
