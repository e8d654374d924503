"""What is known of words that say what is done: `lexicon.json`, its loader, and what a text says by it."""
