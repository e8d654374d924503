"""What the page requests, by what it is about."""
