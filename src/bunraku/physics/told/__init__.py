"""What a file says of how its apparel moves."""
