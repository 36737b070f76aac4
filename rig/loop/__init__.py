"""The compiled loop and its threads."""
