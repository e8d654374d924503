"""What the rows of MMDMC's table 2 are called."""

__all__ = ["BEST", "NBS", "NBS_SHAPES", "OURS", "PARTS", "SPT", "SPT_JOINTS", "UNTRAINED"]

OURS, BEST, PARTS = "ours", "NBS, best skinning that there is", "SPT, floor without training"
NBS, NBS_SHAPES, SPT, SPT_JOINTS = "NBS", "NBS, with blend shapes", "SPT", "SPT, joints given"
UNTRAINED = "untrained"
