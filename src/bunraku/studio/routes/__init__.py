"""What the page asks for, by what it is about."""
