"""The studio: a page on the user's own machine, its server, and the process that does the work."""
