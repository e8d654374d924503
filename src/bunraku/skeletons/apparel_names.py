"""What a bone's name says of apparel: hair, skirts, capes and the like, in English, in Japanese and as the usual tools
write them (`J_Sec_Hair1_01`, `skirt_F_02.L`, `前髪２`, `cc_cape`).
"""

from __future__ import annotations

import re
import unicodedata

from bunraku.skeletons.bone_words import part_of_name

__all__ = ["APPAREL_KINDS", "apparel_of_name"]

APPAREL_KINDS = ("hair", "skirt", "cape", "sleeve", "tail", "ear", "ribbon")
"""What apparel is told apart; each swings in its own manner."""

# Whole words of a name, after it is cut at capitals, digits and signs; earlier kinds are taken before later ones.
_WORDS: tuple[tuple[str, str], ...] = (
    ("hair", r"hairs?|ponytails?|pigtails?|twintails?|pony|bangs?|fringes?|braids?|plaits?|ahoge|locks?|curls?|buns?|"
     r"sideburns?|beard|moustache|mustache|goatee|mane|antennae?|kami|maegami|ushirogami|odango|sidelocks?|twin"),
    ("skirt", r"skirts?|dress(es)?|robes?|gown|kilt|tunic|hems?|petticoat|frills?|ruffles?|loincloth|tabard|apron|"
     r"kimono|hakama|yukata|suso|onepiece|coats?|coattails?|jackets?|tassets?|flaps?|poncho"),
    ("cape", r"capes?|cloaks?|mantles?|manteau|manto|mant|shawl|veils?|hood|stole|cloth(es)?|fabric|banners?|flags?"),
    ("sleeve", r"sleeves?|sode|cuffs?"),
    ("tail", r"tails?|shippo"),
    ("ear", r"ears?|mimi|nekomimi|kemomimi"),
    ("ribbon", r"ribbons?|scarf|scarves|muffler|neckties?|necktie|ties?|bows?|sash|obi|belts?|straps?|strings?|ropes?|"
     r"laces?|tassels?|pendants?|necklaces?|chains?|earrings?|bells?|charms?|feathers?|plumes?|cords?|threads?|"
     r"beads?|tentacles?|whiskers?|himo|accessor(y|ies)|ornaments?|dangles?|dangly|lanyard|reins"),
)  # fmt: skip
_COMPILED = tuple((kind, re.compile(rf"^({pattern})$")) for kind, pattern in _WORDS)
# Words that are joined to others in lower case: "longhair", "frontskirt".
_ENDS = re.compile(r"(hair|skirt|cape|cloak|sleeve|ribbon|scarf|ponytail|pigtail|braid|dress|earring|coat)\d*$")
_KIND_OF_END = {
    "hair": "hair", "ponytail": "hair", "pigtail": "hair", "braid": "hair", "skirt": "skirt", "dress": "skirt",
    "coat": "skirt", "cape": "cape", "cloak": "cape", "sleeve": "sleeve", "ribbon": "ribbon", "scarf": "ribbon",
    "earring": "ribbon",
}  # fmt: skip
_JAPANESE: tuple[tuple[str, str], ...] = (
    (
        "hair",
        r"髪|おさげ|お下げ|アホ毛|あほ毛|くせ毛|ツインテ|ポニテ|ポニー|もみあげ|揉み上げ|触角|触覚|三つ編|みつあみ|お団子|横毛|ハネ毛|はね毛|ヘア",
    ),
    (
        "skirt",
        r"スカート|裾|すそ|ドレス|コート|ワンピ|フリル|前垂|前掛|エプロン|袴|着物|浴衣|羽織|ローブ|腰布|ジャケット|上着",
    ),
    ("cape", r"マント|ケープ|クローク|ベール|ヴェール|ショール|布|フード"),
    ("sleeve", r"袖|そで|スリーブ"),
    ("tail", r"尻尾|しっぽ|シッポ|尾$"),
    ("ear", r"耳"),
    (
        "ribbon",
        r"リボン|ネクタイ|マフラー|スカーフ|紐|ひも|帯|ベルト|鈴|飾|ピアス|イヤリング|ペンダント|ネックレス|チェーン|房|タッセル|羽根|襟|セーラー?|ストラップ",
    ),
)
_JAPANESE_COMPILED = tuple((kind, re.compile(pattern)) for kind, pattern in _JAPANESE)
# What is moved by something else even where a word of apparel is in its name.
_NOT = re.compile(
    r"\b(ik|twist|target|pole|ctrl|control|helper|roll|weapon|sword|gun|eye|brow|lash|arm|leg|hand|foot|finger|toe|thigh)\b"
)
_LIMBS = ("fingers", "wrist", "elbow", "shoulder", "leg", "arm_leg", "foot", "toe", "hips", "spine", "neck", "held")


def apparel_of_name(name: str) -> str:
    """The kind of apparel that a bone's name tells, one of `APPAREL_KINDS`; "" where it tells none."""
    plain = unicodedata.normalize("NFKC", name).split(":")[-1].split("|")[-1]  # kana and letters of half and full width
    if re.search(r"[\u3040-\u30ff\u4e00-\u9fff]", plain):
        if "IK" in plain:
            return ""
        return next((kind for kind, pattern in _JAPANESE_COMPILED if pattern.search(plain)), "")
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", plain)]
    if _NOT.search(" ".join(words)) or part_of_name(name)[0] in _LIMBS:
        return ""
    for kind, pattern in _COMPILED:
        if any(pattern.match(word) for word in words):
            return kind
    for word in words:
        end = _ENDS.search(word)
        if end:
            return _KIND_OF_END[end[1]]
    return ""
