"""The people that are made by code: bodies of MakeHuman and of the reference body, of any shape and proportions, in any
rest pose. `dressed` and `wardrobe` put clothes on them; the solids of `families` are bodies of another kind.
"""
