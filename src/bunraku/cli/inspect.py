"""`bunraku inspect`: what a file holds."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from bunraku.cli.manifest import check_free, note_written
from bunraku.cli.options import UnitOption
from bunraku.cli.outputs import check_input, check_output, size_text, wrote
from bunraku.core.character import Character
from bunraku.errors import CharacterError, WeightsError

if TYPE_CHECKING:
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.apparel.chains.chain import Chain
    from bunraku.core.motion import SkeletalMotion, Skeleton
    from bunraku.files import Document

__all__ = [
    "Inspect", "apparel_facts", "describe", "mmd_facts", "say_chain", "say_part", "shape_facts", "vmd_facts",
    "vrm_facts",
]  # fmt: skip


def mmd_facts(character: Character) -> dict[str, Any]:
    """Bones, morphs, physics and apparel of a character that was read from a PMX or PMD file; nothing of any other."""
    import numpy as np

    from bunraku.apparel.mask import apparel_mask
    from bunraku.core.avatars import mmd_model

    model = mmd_model(character)
    if model is None:
        return {}
    mask = apparel_mask(character, model)
    deforms = np.bincount(model.deforms, minlength=5)
    kinds = dict(zip(("BDEF1", "BDEF2", "BDEF4", "SDEF", "QDEF"), map(int, deforms), strict=True))
    return {
        "model": " / ".join(dict.fromkeys(name for name in (model.name, model.english) if name)),
        "version": model.version,
        "bones": len(model.bones),
        "bones_that_take_over": sum(bone.append is not None for bone in model.bones),
        "inverse_kinematics": [bone.name for bone in model.bones if bone.ik is not None],
        "morphs": len(model.morphs),
        "rigid_bodies": len(model.bodies),
        "rigid_bodies_dynamic": sum(body.dynamic for body in model.bodies),
        "rigid_joints": len(model.joints),
        "apparel_vertices": 0 if mask is None else int(mask.sum()),
        **_drawn(character),
        "deforms": {kind: count for kind, count in kinds.items() if count},
        "warnings": list(model.warnings),
    }


def vmd_facts(path: Path) -> dict[str, Any]:
    """What a VMD file holds.

    Raises:
        FormatError: The file cannot be read.
    """
    from bunraku.anatomy.names.skeleton_map import mmd_skeleton_map
    from bunraku.files import VMD_FPS, load_vmd

    motion = load_vmd(path)
    return {
        "kind": "MMD motion",
        "model": motion.model,
        "frames": motion.last_frame + 1,
        "fps": VMD_FPS,
        "seconds": round(motion.last_frame / VMD_FPS, 3),
        "bones": sorted(motion.bones),
        "morphs": sorted(motion.morphs),
        "keys": sum(len(track.frames) for track in motion.bones.values()),
        "convention": "MikuMikuDance" if mmd_skeleton_map(list(motion.bones)) is not None else "unknown",
        "inverse_kinematics_off": sorted(
            {name for _, states in motion.switches for name, on in states.items() if not on}
        ),
    }


def vrm_facts(character: Character) -> dict[str, Any]:
    """The person's bones, springs and colliders of a VRM avatar; nothing of any other character."""
    from bunraku.apparel.mask import apparel_mask
    from bunraku.core.avatars import vrm_model

    model = vrm_model(character)
    if model is None:
        return {}
    mask = apparel_mask(character, model)
    return {
        "vrm_version": model.version,
        "title": model.title,
        "humanoid_bones": len(model.humanoid),
        "spring_chains": len(model.springs),
        "spring_joints": sum(len(spring.joints) for spring in model.springs),
        "colliders": len(model.colliders),
        "apparel_vertices": 0 if mask is None else int(mask.sum()),
        **_drawn(character),
        "warnings": list(model.warnings),
    }


def _drawn(character: Character) -> dict[str, Any]:
    """The file of a mask that somebody made by hand."""
    from bunraku.apparel.mask import artist_mask_file

    path = artist_mask_file(character)
    return {} if path is None else {"apparel_mask": path.name}


def apparel_facts(character: Character) -> dict[str, Any]:
    """The chains of a character's bones; nothing where its file says how apparel moves, or there are none."""
    from bunraku.apparel.chains.from_bones import bone_chains
    from bunraku.apparel.physics.rig import apparel_rig

    if character.rig is None or apparel_rig(character) is not None:
        return {}
    chains = bone_chains(character)
    if not chains:
        return {}
    return _chain_facts(chains, character.rig.names)


def shape_facts(anatomy: Anatomy) -> dict[str, Any]:
    """What the networks find on a person's mesh: the parts of its apparel, and the chains that are laid over them, as
    `apparel_facts` tells those of bones; nothing where none is found.
    """
    from bunraku.pipelines.clothes import clothed_of, rig_with_chains

    try:
        clothed = clothed_of(anatomy)
        if not clothed.apparel.any():
            return {}
        parts = _part_facts(anatomy.character, clothed)
        made = rig_with_chains(anatomy, clothed=clothed)
    except CharacterError:  # nothing was found, or not on such a body
        return {}
    assert made.character.rig is not None
    return {"apparel": parts} | _chain_facts(made.chains, made.character.rig.names)


def _part_facts(character: Character, clothed: Any) -> list[dict[str, Any]]:
    """Each part of the mask, and how the network takes it to swing."""
    import numpy as np

    from bunraku.apparel.chains.chain import parameters_beside
    from bunraku.apparel.chains.from_shape import part_kinds, shape_chains, with_parts_from_file
    from bunraku.apparel.clothed import FREE, LOADS, NARROW
    from bunraku.core.body.layout import JOINT_NAMES

    kinds = part_kinds(clothed, shape_chains(clothed))
    clothed = with_parts_from_file(clothed, parameters_beside(character))
    whole = max(float(character.areas.sum()), 1e-30)
    out = []
    for number, kind in enumerate(kinds):
        rows = np.flatnonzero(clothed.part == number)
        joint = int(clothed.weights[rows].mean(axis=0).argmax())
        ratio = float(clothed.stiffness[number])
        turn = min(float(clothed.limit[number]), float(np.clip(10.0 ** (LOADS - ratio), NARROW, FREE)))
        out.append(
            {
                "part": number, "kind": kind or "unknown", "vertices": len(rows),
                "area": round(float(character.areas[rows].sum()) / whole, 4), "hangs_on": JOINT_NAMES[joint],
                "stiffness": float(f"{10.0**ratio:.3g}"), "limit": round(float(np.degrees(turn)), 1),
                "damping": round(float(clothed.damping[number]), 3),
            }
        )  # fmt: skip
    return out


def _chain_facts(chains: Sequence[Chain], names: Sequence[str]) -> dict[str, Any]:
    import numpy as np

    return {
        "chains": [
            {
                "name": chain.name, "kind": chain.kind, "links": len(chain), "length": round(chain.length, 4),
                "hangs_on": names[chain.holder],
                "limit": round(float(np.degrees(chain.manner.limit)), 1), "stiffness": chain.manner.stiffness,
                "damping": chain.manner.damping, "gravity": chain.manner.gravity, "mass": chain.manner.mass,
            }
            for chain in chains
        ]
    }  # fmt: skip


def say_chain(chain: dict[str, Any]) -> str:
    """A chain in words: what it was taken for."""
    return f"{chain['name']} ({chain['kind']}, {chain['links']} links on {chain['hangs_on']}, {_manner(chain)})"


def say_part(part: dict[str, Any]) -> str:
    """A part in words."""
    return f"{part['kind']} on {part['hangs_on']} ({part['vertices']:,} vertices, {_manner(part)})"


def _manner(one: dict[str, Any]) -> str:
    return f"turns {one['limit']:g} degrees, stiffness {one['stiffness']:g}, damping {one['damping']:g}"


_USUAL = {"up": "+y", "front": "+z", "taken_up": "+y", "taken_front": "+z"}
GLTF = (".glb", ".gltf", ".vrm")


@dataclass(frozen=True)
class Inspect:
    """Tell what a file holds: its meshes, how they stand, which parts of a body are found and how clearly, rig,
    materials and animations, or the frames and joints of a motion.

    Example: bunraku inspect dragon.glb --json
    """

    file: tyro.conf.Positional[Path]
    """A character or a motion."""
    unit: UnitOption = "auto"
    """The unit of lengths in a character's file. "auto" says what the height makes likely and leaves them as they are.
    """
    json: bool = False
    """Print JSON for programs."""
    views: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Write a picture (.png) of the four likeliest ways in which a character may stand, each with what to type for it.
    """
    apparel: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Write what is guessed of hair and clothes to a TOML to be changed: girl.apparel.toml beside girl.obj counts."""
    overwrite: bool = False
    """Replace a file that is there already and that Bunraku did not write."""

    def run(self) -> None:
        check_input(self.file)
        if self.views is not None:
            self._draw_views(self.views)
        if self.apparel is not None:
            check_output(self.apparel, (".toml",), [self.file])
            check_free([self.apparel], self.overwrite)
        facts = describe(self.file, self.unit)
        if self.apparel is not None:
            self._write_apparel(self.apparel, facts.get("chains", []))
        if self.json:
            import json

            print(json.dumps(facts, indent=2))
        else:
            _print(facts)

    def _write_apparel(self, path: Path, chains: list[dict[str, Any]]) -> None:
        from bunraku.apparel.chains.chain import SUFFIX, write_parameters

        if not chains:
            raise CharacterError(
                f"{self.file.name}: nothing is guessed of its hair and clothes, or its file says how they move; leave "
                "out --apparel"
            )
        write_parameters(chains, path)
        note_written([path])
        if not self.json:
            wrote(path)
        counts = self.file.with_name(f"{self.file.stem}{SUFFIX}")
        if path.resolve() != counts.resolve():
            print(f"it counts as {counts}", file=sys.stderr)

    def _draw_views(self, path: Path) -> None:
        from bunraku.files import load_character
        from bunraku.render.pictures import write_png
        from bunraku.render.preview import orientation_views

        check_output(path, (".png",), [self.file])
        check_free([path], self.overwrite)
        write_png(orientation_views(load_character(self.file, unit="m")), path)
        note_written([path])
        wrote(path)


def describe(path: Path, unit: str = "auto") -> dict[str, Any]:
    """What a file holds, in values that JSON can say; lengths in metres and seconds.

    Raises:
        FormatError: The file cannot be read.
        CharacterError: It holds no mesh that can be animated.
    """
    facts: dict[str, Any] = {"file": str(path), "bytes": path.stat().st_size}
    if path.suffix.lower() in (".npz", ".npy", ".bvh", ".vrma"):
        return facts | _motion(path)
    from bunraku.files import load_character

    if path.suffix.lower() == ".vmd":
        return facts | vmd_facts(path)
    fbx = _fbx(path) if path.suffix.lower() == ".fbx" else {}
    if fbx and not fbx["meshes"]:  # clips without a character
        return facts | _motion(path) | fbx
    character = load_character(path, unit="m" if unit == "auto" else unit)
    suffix = getattr(character.source, "suffix", path.suffix.lower())
    facts |= _character(character, unit)
    if character.source is not None:
        facts |= _document(character.source.document)
    if suffix not in GLTF:
        facts.pop("generator", None)  # the document stands for a file of another format
    up, front = facts["orientation"]["taken_up"], facts["orientation"]["taken_front"]
    return facts | _body(character, up, front) | fbx | mmd_facts(character) | vrm_facts(character)


def _body(character: Character, up: str, front: str) -> dict[str, Any]:
    """What handles make of it: what it stands on, which parts are found and how clearly, and what it cannot do."""
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.anatomy.handles.predict import predict_handles
    from bunraku.files import turned
    from bunraku.pipelines.bodies import body_facts

    try:
        standing = turned(character, up, front)
        anatomy = Anatomy.of(standing, predict_handles(standing))
        found = body_facts(anatomy)
    except (WeightsError, CharacterError) as error:
        return {"body": None, "body_note": str(error)}
    parts = [{"name": part.name, "area": round(part.area, 4), "clear": round(part.sure, 3)} for part in found.parts]
    facts = {"body": found.plan.words, "parts": parts, "cannot": list(found.cannot)}
    return facts if _says_apparel(character) else facts | shape_facts(anatomy)


def _says_apparel(character: Character) -> bool:
    """Whether its file says what of it is apparel, by bones or physics."""
    from bunraku.apparel.chains.moving import moving_rig

    return moving_rig(character) is not None


def _fbx(path: Path) -> dict[str, Any]:
    from bunraku.core.files import read_bounded
    from bunraku.files import fbx_facts

    return fbx_facts(path, read_bounded(path))


def _motion(path: Path) -> dict[str, Any]:
    from bunraku.core.motion import HandleMotion, SkeletalMotion
    from bunraku.files import read_motion

    motion = read_motion(path)
    facts: dict[str, Any] = {"kind": "handle motion" if isinstance(motion, HandleMotion) else "skeletal motion"}
    facts |= {"frames": len(motion), "fps": float(motion.fps), "seconds": round(len(motion) / motion.fps, 3)}
    if isinstance(motion, HandleMotion):
        facts["handles"] = motion.translations.shape[1]
    elif isinstance(motion, SkeletalMotion):
        facts["joints"] = len(motion.skeleton.names)
        facts |= _mapping(motion.skeleton) | _animal(motion)
    travel = motion.root_translation[-1] - motion.root_translation[0]
    return facts | {"root_travel": [round(float(x), 3) for x in travel]}


def _animal(motion: SkeletalMotion) -> dict[str, Any]:
    """What stands in the motion, where that is no person."""
    from bunraku.pipelines.to_reference import creature_motion

    found = creature_motion(motion)
    return {} if found is None else {"body": found.plan.words}


def _mapping(skeleton: Skeleton) -> dict[str, Any]:
    """Which joints play the parts of a person, as far as that is found."""
    from bunraku.anatomy.names.skeleton_map import map_skeleton
    from bunraku.core.body.layout import JOINT_NAMES
    from bunraku.errors import MotionError

    try:
        found = map_skeleton(skeleton)
    except MotionError:
        return {"convention": "unknown", "mapping": {}}
    named = {name: skeleton.names[joint] for name, joint in zip(JOINT_NAMES, found.joints, strict=True) if joint >= 0}
    return {"convention": found.convention or "unknown", "mapping": named, "missing": list(found.missing)}


def _character(character: Character, unit: str) -> dict[str, Any]:
    import numpy as np

    low, high = character.vertices.min(axis=0), character.vertices.max(axis=0)
    extent = high - low
    welded, parts = _count_parts(character)
    orientation = _orientation(character)
    suffix = str(getattr(character.source, "suffix", ""))
    height = (
        float(np.ptp(character.vertices[character.surface], axis=0)["xyz".index(orientation["taken_up"][1])])
        or character.height
    )
    facts: dict[str, Any] = {
        "kind": "character",
        "name": character.name,
        "vertices": len(character.vertices),
        "vertices_welded": welded,
        "faces": len(character.faces),
        "loose_parts": parts,
        "height": _digits(height),
        "unit": _unit(height, suffix, unit),
        "extent": [_digits(x) for x in extent],
        "lowest_corner": [_digits(x) for x in low],
        "orientation": orientation,
        "rig": None,
    }
    if character.rig is not None:
        influences = int((character.rig.weights > 0).sum(axis=1).max(initial=0))
        facts["rig"] = {
            "joints": len(character.rig.names),
            "influences": influences,
            "names": list(character.rig.names),
        }
    return facts | apparel_facts(character)


def _digits(value: Any) -> float:
    """Five digits that count, whatever the unit."""
    return float(f"{float(value):.5g}")


def _count_parts(character: Character) -> tuple[int, int]:
    """Vertices and loose parts once seams and repeated vertices are welded."""
    from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges

    clean = clean_mesh(character.vertices, character.faces)
    count = len(clean.vertices)
    return count, int(mesh_parts(unique_edges(clean.faces, count), count).max()) + 1


def _orientation(character: Character) -> dict[str, Any]:
    """How the character seems to stand, and what animate and rig make of it."""
    from bunraku.cli.options import resolve_file

    try:
        resolved, note = resolve_file(character)
    except WeightsError as error:
        return {**_USUAL, "up_confidence": None, "front_confidence": None, "note": f"assumed: {error}"}
    guess = resolved.guess
    assert guess is not None
    return {
        "up": guess.up,
        "front": guess.front,
        "up_confidence": round(guess.up_confidence, 3),
        "front_confidence": round(guess.front_confidence, 3),
        "taken_up": resolved.up,
        "taken_front": resolved.front,
        "note": note,
    }


def _unit(height: float, suffix: str, unit: str) -> dict[str, str]:
    """What unit the file is likely to be in, and what animate and rig make of it."""
    from bunraku.files import UNIT_NAMES, resolve_unit

    resolved = resolve_unit(height, suffix, "auto")
    if unit != "auto":
        return {"name": UNIT_NAMES[unit], "note": ""}
    return {"name": UNIT_NAMES[resolved.likely], "note": resolved.note}


def _document(document: Document) -> dict[str, Any]:
    animations = []
    for number, animation in enumerate(document.items("animations")):
        ends = [
            float(document.accessor(sampler.get("input"), ("SCALAR",)).max(initial=0))
            for sampler in document.objects(animation, "samplers")
        ]
        name = str(animation.get("name") or f"animation {number}")
        animations.append(
            {
                "name": name,
                "seconds": round(max(ends, default=0.0), 3),
                "channels": len(document.objects(animation, "channels")),
            }
        )
    return {
        "generator": str(document.tree["asset"].get("generator", "")),
        "meshes": len(document.items("meshes")),
        "primitives": sum(len(document.objects(mesh, "primitives")) for mesh in document.items("meshes")),
        "materials": [
            str(material.get("name") or f"material {number}")
            for number, material in enumerate(document.items("materials"))
        ],
        "textures": len(document.items("textures")),
        "skins": len(document.items("skins")),
        "animations": animations,
        "extensions": sorted(str(name) for name in document.tree.get("extensionsUsed", [])),
    }


def _print(facts: dict[str, object]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for key, value in facts.items():
        table.add_row(Text(key.replace("_", " ")), Text(_say(key, value)))
    Console().print(table)


def _say(key: str, value: Any) -> str:
    if key == "bytes":
        return size_text(value)
    if key in ("height", "seconds"):
        return f"{value:g} {'m' if key == 'height' else 's'}"
    if key in ("extent", "lowest_corner", "root_travel"):
        return (
            " x ".join(f"{x:g}" for x in value) + " m" if key == "extent" else ", ".join(f"{x:g}" for x in value) + " m"
        )
    if key == "orientation":
        up, front = (f"{value[which].upper()} ({_sure(value[which + '_confidence'])})" for which in ("up", "front"))
        return value["note"] or f"up {up}, front {front}"
    if key == "unit":
        return value["note"] or value["name"]
    if key == "rig":
        return (
            "none"
            if value is None
            else f"{value['joints']} joints, up to {value['influences']} influences a vertex: {_short(value['names'])}"
        )
    if key == "mapping":
        return (
            ", ".join(f"{name} = {own}" for name, own in value.items())
            or "none found; a person has a pelvis and two legs"
        )
    if key == "parts":
        return ", ".join(f"{part['name']} ({100 * part['clear']:.0f} % clear)" for part in value)
    if key == "apparel":
        return _short([say_part(part) for part in value])
    if key == "chains":
        return _short([say_chain(chain) for chain in value])
    if key == "cannot":
        return "; ".join(value) or "nothing is known that it cannot do"
    if key == "animations":
        return _short([f"{clip['name']} ({clip['seconds']:g} s)" for clip in value]) if value else "none"
    if key == "deforms":
        return ", ".join(f"{kind} {count:,}" for kind, count in value.items())
    if isinstance(value, list):
        return f"{len(value)}: {_short(value)}" if value else "none"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _sure(share: float) -> str:
    return f"{100 * min(share, 0.99):.0f} % sure"


def _short(names: list[str], limit: int = 12) -> str:
    more = f", and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more
