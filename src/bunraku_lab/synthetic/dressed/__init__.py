"""Dressed people to train on: MakeHuman bodies of every shape and age, in clothes, in proportions of games.

`dressed_person` makes one.
"""

from bunraku_lab.synthetic.dressed.garments import Wardrobe
from bunraku_lab.synthetic.dressed.people import Dressed, dressed_person

__all__ = ["Dressed", "Wardrobe", "dressed_person"]
