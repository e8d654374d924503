"""Physics for characters whose files have none: chains of bones, how each kind of them swings, and the rigid bodies and
joints that they become.
"""
