"""What the worker does: open a character, make takes, change them, carry a motion over, play clips, write files."""
