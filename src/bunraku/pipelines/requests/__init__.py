"""What is requested: a sentence or a motion, how it is drawn, what it must meet, and how apparel moves."""
