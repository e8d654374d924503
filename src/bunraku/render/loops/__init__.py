"""The loops of the renderer, in C and in numpy."""
