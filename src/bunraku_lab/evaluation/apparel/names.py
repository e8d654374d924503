"""What the rows of MMDMC's table 2 are called."""

__all__ = ["BEST", "OURS", "PARTS"]

OURS, BEST, PARTS = "ours", "NBS, best skinning that there is", "SPT, floor without training"
