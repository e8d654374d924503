"""The web server: the application, its guard, and the command that serves it."""
