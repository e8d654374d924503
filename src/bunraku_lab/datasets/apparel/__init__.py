"""The apparel data set: characters in clothes that physics move, to train and test apparel networks on (MMDMC, section
3).
"""

from bunraku_lab.datasets.apparel.shards import ApparelCharacter, ApparelClip, ApparelData, ApparelWindow

__all__ = ["ApparelCharacter", "ApparelClip", "ApparelData", "ApparelWindow"]
