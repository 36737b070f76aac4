"""Reproduce papers: compute the numbers behind every claim, and write the report's sentences from them."""
