"""What is said of a motion by looking at it alone: turns, ways, gaits, kicks, waves, sitting down."""
