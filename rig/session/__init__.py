"""Experiments with participants: protocol, search rules, engine that conducts a session, log, and terminal."""
