"""Dressed people to train on: MakeHuman bodies of every shape and age, in clothes, with hats and capes, in the proportions of games.

`build_dressed` writes them into a cache of training characters; `dressed_person` makes one.
"""

from bunraku.synthetic.dressed.people import Dressed, build_dressed, dressed_person, training_dressed
from bunraku.synthetic.dressed.wardrobe import Wardrobe

__all__ = ["Dressed", "Wardrobe", "build_dressed", "dressed_person", "training_dressed"]
