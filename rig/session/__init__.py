"""Experiments with people: protocol, engine, log, desk."""
