"""What of the two papers reproduces, computed and said by one command each."""
