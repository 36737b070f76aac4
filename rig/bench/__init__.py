"""What machine, link and board can do, and whether a wall may be armed; building and flashing firmware."""
