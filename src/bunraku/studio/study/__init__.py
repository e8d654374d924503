"""The blind study: made, and shown."""
