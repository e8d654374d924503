"""Captions of training: the phrases of labels, sentences of what was watched, and the grammar that makes them."""
