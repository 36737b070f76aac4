"""Where linear theory and hits differ, and why: every wall hit, causes removed one by one, limit cycles predicted."""
