"""What a protocol plans: sections and their rules, conditions, order, times, and what a search will come to."""
