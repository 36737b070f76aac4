"""Find the walls where linear theory and simulated hits differ, and the cause; predict limit cycles."""
