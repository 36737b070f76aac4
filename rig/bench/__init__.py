"""What machine, link and board can do, and whether a wall may be armed; firmware; bridges to drives."""
