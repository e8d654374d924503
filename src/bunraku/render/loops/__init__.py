"""The loops of the renderers, in C and in numpy."""
