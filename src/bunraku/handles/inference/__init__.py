"""The networks of handles and orientation, as they run: in numpy."""
