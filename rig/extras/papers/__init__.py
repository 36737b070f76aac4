"""Reproductions of papers: every claim computed, every sentence about a result taken from its numbers."""
