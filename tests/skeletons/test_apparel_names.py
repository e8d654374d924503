"""Names of bones of hair and clothes, as tools write them."""

import pytest

from bunraku.skeletons.apparel_names import APPAREL_KINDS, apparel_of_name


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("J_Sec_Hair1_01", "hair"), ("J_Sec_L_CoatSkirtBack1_01", "skirt"), ("skirt_F_02.L", "skirt"),
        ("longhair_03", "hair"), ("cape_01", "cape"), ("mixamorig:Hair1", "hair"), ("Ear1.L", "ear"), ("Tail1", "tail"),
        ("beard", "hair"), ("前髪２", "hair"), ("スカート0_1", "skirt"), ("左ｽｶｰﾄ前", "skirt"), ("ﾈｸﾀｲ１", "ribbon"),
        ("左袖1_2", "sleeve"), ("ポニテ_3", "hair"), ("マント", "cape"), ("尻尾2", "tail"),
    ],
)  # fmt: skip
def test_apparel(name, kind):
    assert apparel_of_name(name) == kind and kind in APPAREL_KINDS


@pytest.mark.parametrize(
    "name",
    ["LeftForeArm", "gear", "rear_leg", "crib", "Head", "mixamorig:HeadTop_End", "TailIK", "左腕", "左足ＩＫ",
     "bow_arm",
     "UpperArmTwist", "hair_ctrl", "Spine1", ""],
)  # fmt: skip
def test_no_apparel(name):
    assert apparel_of_name(name) == ""
