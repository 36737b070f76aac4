"""Mechanics and law in one compiled call, without bytes: a trial, many hits, an excited rig."""
