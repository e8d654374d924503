"""The apparel data set: characters in clothes that physics move (section 3 of MMDMC)."""

from bunraku_lab.datasets.apparel.shards import ApparelCharacter, ApparelClip, ApparelData, ApparelWindow

__all__ = ["ApparelCharacter", "ApparelClip", "ApparelData", "ApparelWindow"]
