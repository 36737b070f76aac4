"""Pictures and pages of results; they may fail without harm."""
