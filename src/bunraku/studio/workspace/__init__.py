"""What the worker works with: characters that are open, takes on disk and on the wire, apparel."""
