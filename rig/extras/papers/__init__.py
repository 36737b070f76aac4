"""Reproduce published papers: compute the numbers behind every claim, judge the claims, and write a report."""
