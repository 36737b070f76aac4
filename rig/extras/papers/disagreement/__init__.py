"""Find the walls that linear theory and simulated hits judge differently, and the cause; predict limit cycles."""
