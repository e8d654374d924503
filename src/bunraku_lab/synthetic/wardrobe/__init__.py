"""The wardrobe: dressed characters made by code, with rigs, rigid bodies and joints of their own, as MMD models."""

from bunraku_lab.synthetic.wardrobe.character import build_wardrobe, wardrobe_character, wardrobe_costume

__all__ = ["build_wardrobe", "wardrobe_character", "wardrobe_costume"]
