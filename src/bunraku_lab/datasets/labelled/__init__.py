"""Characters of which every vertex is labelled: what part it is of, what carries it, whether it hangs."""
