"""What one bone name says on its own: its side, its part of the body, or a kind of apparel."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

# Kinds that name a handle outright; "left" stands for the side that the joint has.
_KINDS: tuple[tuple[str, str], ...] = (
    ("none", r"(pole)?target|^pt$|^control|camera|^light|nub$|heelroll|toeroll|twistend"),
    ("head_top",
    r"^(outer|inner|upper|lower)?ears?(tip|end)?$|hair|^hat|hood|horn|antenna|antler|helmet|headtop|headend|headnub"
     r"|ahoge|ponytail|crest|bangs?$|crown"),
    ("face", r"eye|brow|jaw|mouth|nose|snout|tongue|^lips?|cheek|teeth|tooth|beak|chin$|muzzle|whisker"),
    ("face_bone", r"^face$"),
    ("fingers",
    r"thumb|finger|^(hand)?index|^(hand)?middle(proximal|intermediate|distal|metacarpal)?$|^(hand)?ring|pinky|^(hand)?little|claw$"),
    ("held", r"weapon|gun$|handslot|^prop$|^item$|sword|shield"),
    ("wrist", r"^(wrist|hand|palm[pritm]?|fist|middlehand|carpus)$"),
    ("elbow", r"forearm|lowerarm|lowarm|elbow|ulna|radius"),
    ("shoulder", r"upperarm|uparm|^arm$|humerus|armtwist"),
    ("collar", r"^shoulder$|clavicle|collar|scapula|frontshoulder"),
    ("chest_bone", r"^shoulders$"),
    ("wing", r"wing"),
    ("flipper", r"flipper|^fins?$|pectoral"),
    ("toe", r"toe|^ball$|football"),
    ("front_foot", r"^(ik)?front(foot|feet|paw|hoof)$|^ff$|^ikfrontleg$"),
    ("hind_paw", r"^ffb$|^ikbackleg$"),
    ("foot", r"foot|feet|ankle|heel|hoof|paw$"),
    ("hip_bone", r"backshoulder|backhip|legroot|legconnector"),
    ("arm_leg", r"^(mid)?frontleg$|^frontup(per)?leg$|^frontlow(er)?leg$|^topleg$"),
    ("leg", r"leg$|thigh|^shin$|calf|^knee$|femur|tibia|hock"),
    ("tail", r"tail"),
    ("sting", r"^sting(er)?$"),
    ("hips", r"^hips?$|pelvis"),
    ("abdomen", r"^abdomen$"),
    ("back", r"^back$"),
    ("body", r"^body(root)?$"),
    ("spine", r"spine|torso|chest|thorax|belly|rib(s|cage)|waist|trunk|lumbar"),
    ("neck", r"neck"),
    ("head", r"^head$|skull"),
    ("main", r"^main$"),
    ("root", r"^(root|bone|center|origin|armature|cog|reference)$"),
)  # fmt: skip
_COMPILED = tuple((kind, re.compile(pattern)) for kind, pattern in _KINDS)
_SIDED = ("fingers", "wrist", "elbow", "shoulder", "collar", "wing", "flipper", "toe", "foot", "leg", "hips")
_WHERE = {"front", "fore", "back", "hind", "rear", "upper", "lower", "up", "low"}
_LIMB = rf"(?:{'|'.join(sorted(_WHERE))})*(?:{'|'.join(dict(_KINDS)[kind] for kind in _SIDED)})"
_LIMB = re.sub(r"[\^$]", "", re.sub(r"\((?!\?)", "(?:", _LIMB))  # whole words, and no groups of their own
# A side in one word with its limb: "lefthand" and whatever else a long side begins, but "larm" and "legr" only where
# the rest is wholly the word of a limb, since "lower" and "finger" have such letters too.
_GLUED = re.compile(f"^(?!(?:{_LIMB})$)(?:(left|right)(.+)|([lr])({_LIMB})|({_LIMB})([lr]))$")

# The corner of a leg in two letters, front or back and left or right.
_CORNERS = {where[0] + side: f"{where} {side}" for where in ("front", "back", "hind", "rear") for side in ("l", "r")}

# The standard bones of MikuMikuDance; a leading 左 or 右 is the side.
_MMD = {
    "センター": "none", "グルーブ": "none", "全ての親": "none", "操作中心": "none", "腰": "hips", "下半身": "hips",
    "上半身": "spine",
    "上半身2": "spine", "上半身3": "spine", "首": "neck", "頭": "head", "肩": "collar", "肩P": "none", "肩C": "none",
    "腕": "shoulder",
    "腕捩": "shoulder", "ひじ": "elbow", "手捩": "elbow", "手首": "wrist", "足": "leg", "ひざ": "leg",
    "足首": "foot", "つま先": "toe",
    "足先EX": "toe", "目": "face", "両目": "face", "あご": "face", "舌": "face", "耳": "head_top", "髪": "head_top",
    "前髪": "head_top",
    "後髪": "head_top", "横髪": "head_top", "尻尾": "tail", "しっぽ": "tail", "羽": "wing", "翼": "wing",
    "ダミー": "none",
}  # fmt: skip
_MMD_PARTS = (
    ("head_top", r"髪|耳|おさげ|アホ毛|くせ毛|ツインテ|ポニテ|帽"),
    ("tail", r"^(尻?尾|しっぽ)"),
    ("wing", r"翼|羽|マント|クローク|ケープ"),
    ("toe", r"^(つま先|足先)"),
)
_MMD_FINGERS = ("親指", "人指", "人差指", "中指", "薬指", "小指")
_WIDE = str.maketrans(
    "０１２３４５６７８９ＡＢＣＤＥＦＧＨＩＪＫＬＭＮＯＰＱＲＳＴＵＶＷＸＹＺ", "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"
)
_DROP = {
    "j", "bip", "bip01", "bip001", "sec", "c", "def", "org", "mch", "jnt", "joint", "bn", "b", "end", "mixamorig", "cc",
    "base", "valvebiped", "stretch", "x",
}  # fmt: skip
_CJK = re.compile(r"[\u3040-\u30ff\u4e00-\u9fff]")
SHARED = 0.9  # of the names of a rig begin with its own name, where any do


def plain_name(name: str) -> str:
    """A bone's name with the wide letters and digits that only some models use made narrow."""
    return name.translate(_WIDE)


def without_prefix(names: Sequence[str]) -> tuple[str, ...]:
    """Names without the name of the character that they begin with: `Neo_LeftHand` is `LeftHand` where all of them do.

    A prefix ends before a capital or behind a sign, so that it is whole words.
    """
    known = sorted(name for name in names if not _CJK.search(name))
    if len(known) < 4:
        return tuple(names)
    spare = int((1 - SHARED) * len(known) / 2)
    first, last = known[spare], known[-1 - spare]  # what nearly all share, those near both ends of the alphabet do
    length = next((place for place, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), 0)
    prefix = first[:length]
    while prefix and not (prefix[-1] in "_-. :" or (prefix[-1].islower() and first[len(prefix) :][:1].isupper())):
        prefix = prefix[:-1]
    kind, side, _, _ = part_of_name(prefix)
    if len(prefix) < 2 or kind or side or sum(name.startswith(prefix) for name in known) < SHARED * len(known):
        return tuple(names)
    return tuple(name[len(prefix) :] or name if name.startswith(prefix) else name for name in names)


@lru_cache(maxsize=16384)  # rigs have hundreds of names, and are read several times
def part_of_name(name: str) -> tuple[str, int, int, bool]:
    """What one name says on its own.

    Returns:
        The kind of part ("" when unknown), the side (+1 left, -1 right, 0 none), the first number in the name (0 when
        there is none), and whether the name is that of an inverse-kinematics target.
    """
    plain = plain_name(name).split(":")[-1].split("|")[-1]
    if _CJK.search(plain):
        side = 1 if plain.startswith("左") else -1 if plain.startswith("右") else 0
        rest = plain[1:] if side else plain
        if any(rest.startswith(finger) for finger in _MMD_FINGERS):
            return "fingers", side, 0, False
        if "IK" in rest:
            return "none", side, 0, True
        stem = rest if rest in _MMD else rest.rstrip("0123456789D先親")
        kind = _MMD.get(stem) or next((part for part, pattern in _MMD_PARTS if re.search(pattern, rest)), "")
        return kind, side, 0, False
    plain = re.sub(r"\.\d+$", "", plain)  # Blender's copies
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", plain)
    words = " ".join(_CORNERS.get(word.lower(), word.lower()) for word in words).split()
    side, number, target, kept = 0, 0, False, []
    for word in (part for whole in words for part in _GLUED.split(whole) if part):
        if word in ("l", "left", "r", "right"):
            side = 1 if word.startswith("l") else -1
        elif word.isdigit():
            number = number or int(word)
        elif word == "ik":
            target = True
        elif word not in _DROP:
            kept.append(word)
    kept = [word for word in kept if word != "bone"] or kept
    joined = "".join(kept)
    if joined == "head" and number >= 2:
        return "head_top", side, number, target
    if target and joined in ("frontleg", "backleg"):
        joined = "ik" + joined
    words_of = joined if _kind_of(joined) else _noun_last(kept)
    kind = _kind_of(words_of)
    if kind == "fingers" and words_of.startswith("middlehand"):
        kind = "wrist"
    if kind == "leg" and number == 0 and words_of in ("frontleg", "midfrontleg"):
        kind = "arm_leg"
    return kind, side, number, target


@lru_cache(maxsize=4096)  # names of a chain differ in their numbers alone
def _kind_of(words: str) -> str:
    return next((kind for kind, pattern in _COMPILED if pattern.search(words)), "")


def _noun_last(words: list[str]) -> str:
    """The words of a name with its part at the end: a leg that is said to be upper afterwards is an upper leg, and of
    the shoulder of a leg the shoulder counts.
    """
    limb = next((place for place, word in enumerate(words) if word in ("leg", "arm")), len(words))
    after = words[limb + 1 :]
    return "".join([*words[:limb], *after, *(words[limb : limb + 1] if set(after) <= _WHERE else [])])


_BLOCKS = {
    "head": "head", "neck": "head", "shoulder": "arm", "elbow": "arm", "wrist": "arm", "fingers": "arm",
    "collar": "arm", "flipper": "arm", "leg": "leg", "foot": "leg", "toe": "leg", "hip_bone": "leg", "hind_paw": "leg",
    "arm_leg": "front leg", "front_foot": "front leg", "tail": "tail", "wing": "wing", "hips": "trunk",
    "spine": "trunk", "abdomen": "trunk", "body": "trunk", "back": "trunk", "held": "carried", "head_top": "carried",
    "face": "carried", "face_bone": "carried",
}  # fmt: skip


def block_of_name(name: str) -> tuple[str, str]:
    """What the name of a rigid block says.

    Returns:
        The limb that it is a part of: "head", "arm", "leg", "front leg", "tail", "wing", "trunk", "carried" for what
        goes along with another block, "" when unknown; and the kind of `part_of_name`.
    """
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", plain_name(name))
    first = [word for word in words if word.lower() in _WHERE]
    rest = [word for word in words if word.lower() not in _WHERE]
    kind, side, _, _ = part_of_name("_".join(["front" if word.lower() == "fore" else word for word in first] + rest))
    limb = _BLOCKS.get(kind, "")
    return ("leg" if kind == "hips" and side else limb), kind


def left_axis(names: Sequence[str], positions: np.ndarray) -> np.ndarray | None:
    """The horizontal direction from joints named right to joints named left, shape (3,); None without such names.

    In glTF's frame a character that faces +Z has its left at +X. Only pairs of the same kind count.
    """
    sums: dict[tuple[str, int, int], list[np.ndarray]] = {}
    for name, position in zip(without_prefix(names), positions, strict=True):
        kind, side, number, target = part_of_name(name)
        if side and kind and kind != "none" and not target:
            sums.setdefault((kind, number, side), []).append(np.asarray(position, float))
    axis = np.zeros(3)
    for (kind, number, side), left in sums.items():
        right = sums.get((kind, number, -1))
        if side == 1 and right:
            axis += np.mean(left, axis=0) - np.mean(right, axis=0)
    axis[1] = 0
    length = float(np.linalg.norm(axis))
    return axis / length if length > 1e-9 else None


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
_APPAREL_COMPILED = tuple((kind, re.compile(rf"^({pattern})$")) for kind, pattern in _WORDS)
# Words that are joined to others in lower case: "longhair", "frontskirt".
_ENDS = re.compile(r"(hair|skirt|cape|cloak|sleeve|ribbon|scarf|ponytail|pigtail|braid|dress|earring|coat)\d*$")
_KIND_OF_END = {
    "hair": "hair", "ponytail": "hair", "pigtail": "hair", "braid": "hair", "skirt": "skirt", "dress": "skirt",
    "coat": "skirt", "cape": "cape", "cloak": "cape", "sleeve": "sleeve", "ribbon": "ribbon", "scarf": "ribbon",
    "earring": "ribbon",
}  # fmt: skip
_JAPANESE: tuple[tuple[str, str], ...] = (
    ("hair", r"髪|おさげ|お下げ|アホ毛|あほ毛|くせ毛|ツインテ|ポニテ|ポニー|もみあげ|揉み上げ|触角|触覚|三つ編|"
     r"みつあみ|お団子|横毛|ハネ毛|はね毛|ヘア"),
    ("skirt", r"スカート|裾|すそ|ドレス|コート|ワンピ|フリル|前垂|前掛|エプロン|袴|着物|浴衣|羽織|"
     r"ローブ|腰布|ジャケット|上着"),
    ("cape", r"マント|ケープ|クローク|ベール|ヴェール|ショール|布|フード"),
    ("sleeve", r"袖|そで|スリーブ"),
    ("tail", r"尻尾|しっぽ|シッポ|尾$"),
    ("ear", r"耳"),
    ("ribbon", r"リボン|ネクタイ|マフラー|スカーフ|紐|ひも|帯|ベルト|鈴|飾|ピアス|イヤリング|ペンダント|ネックレス|"
     r"チェーン|房|タッセル|羽根|襟|セーラー?|ストラップ"),
)  # fmt: skip
_JAPANESE_COMPILED = tuple((kind, re.compile(pattern)) for kind, pattern in _JAPANESE)
# What is moved by something else even where a word of apparel is in its name.
_NOT = re.compile(
    r"\b(ik|twist|target|pole|ctrl|control|helper|roll|weapon|sword|gun|eye|brow|lash|arm|leg|hand|foot|finger|toe|thigh)\b"
)
_LIMBS = ("fingers", "wrist", "elbow", "shoulder", "leg", "arm_leg", "foot", "toe", "hips", "spine", "neck", "held")


def apparel_of_name(name: str) -> str:
    """The kind of apparel that a bone's name tells, one of `APPAREL_KINDS`; "" where it tells none."""
    plain = unicodedata.normalize("NFKC", name).split(":")[-1].split("|")[-1]  # kana and letters of half and full width
    if _CJK.search(plain):
        if "IK" in plain:
            return ""
        return next((kind for kind, pattern in _JAPANESE_COMPILED if pattern.search(plain)), "")
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", plain)]
    if _NOT.search(" ".join(words)) or part_of_name(name)[0] in _LIMBS:
        return ""
    for kind, pattern in _APPAREL_COMPILED:
        if any(pattern.match(word) for word in words):
            return kind
    ends = [end for word in words if (end := _ENDS.search(word))]
    return _KIND_OF_END[ends[0][1]] if ends else ""
