"""What this machine and a link can do, and what would mend what they cannot."""
