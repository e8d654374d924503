"""`bunraku inspect`: what a file holds."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from bunraku.cli.manifest import check_free, note_written
from bunraku.cli.options import UnitOption
from bunraku.cli.shared import OverwriteOption, check_input, check_output, size_text, wrote
from bunraku.core.character import Character
from bunraku.errors import CharacterError, WeightsError

if TYPE_CHECKING:
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.apparel.chains.chain import Chain
    from bunraku.core.motion import Skeleton
    from bunraku.files import Document


def avatar_facts(character: Character) -> dict[str, Any]:
    """Bones, physics and apparel of a PMX, PMD or VRM file; nothing of any other character."""
    import numpy as np

    from bunraku.apparel.mask import apparel_mask, artist_mask_file
    from bunraku.core.avatars import mmd_model, vrm_model

    mmd, vrm = mmd_model(character), vrm_model(character)
    model = mmd or vrm
    if model is None:
        return {}
    mask, drawn = apparel_mask(character, model), artist_mask_file(character)
    apparel = {"apparel_vertices": 0 if mask is None else int(mask.sum())}
    shared = apparel if drawn is None else {**apparel, "apparel_mask": drawn.name}
    warnings = {"warnings": list(model.warnings)}
    if mmd is None:
        assert vrm is not None
        return {
            "vrm_version": vrm.version,
            "title": vrm.title,
            "humanoid_bones": len(vrm.humanoid),
            "spring_chains": len(vrm.springs),
            "spring_joints": sum(len(spring.joints) for spring in vrm.springs),
            "colliders": len(vrm.colliders),
        } | shared | warnings  # fmt: skip
    deforms = np.bincount(mmd.deforms, minlength=5)
    kinds = dict(zip(("BDEF1", "BDEF2", "BDEF4", "SDEF", "QDEF"), map(int, deforms), strict=True))
    return {
        "model": " / ".join(dict.fromkeys(name for name in (mmd.name, mmd.english) if name)),
        "version": mmd.version, "bones": len(mmd.bones),
        "bones_that_take_over": sum(bone.append is not None for bone in mmd.bones),
        "inverse_kinematics": [bone.name for bone in mmd.bones if bone.ik is not None], "morphs": len(mmd.morphs),
        "rigid_bodies": len(mmd.bodies), "rigid_bodies_dynamic": sum(body.dynamic for body in mmd.bodies),
        "rigid_joints": len(mmd.joints), **shared,
        "deforms": {kind: count for kind, count in kinds.items() if count}, **warnings,
    }  # fmt: skip


def vmd_facts(path: Path) -> dict[str, Any]:
    """What a VMD file holds; FormatError where the file cannot be read."""
    from bunraku.anatomy.names.skeleton_map import mmd_skeleton_map
    from bunraku.files import VMD_FPS, load_vmd

    motion = load_vmd(path)
    switched_off = {name for _, states in motion.switches for name, on in states.items() if not on}
    return {
        "kind": "MMD motion", "model": motion.model, "frames": motion.last_frame + 1, "fps": VMD_FPS,
        "seconds": round(motion.last_frame / VMD_FPS, 3), "bones": sorted(motion.bones),
        "morphs": sorted(motion.morphs), "keys": sum(len(track.frames) for track in motion.bones.values()),
        "convention": "MikuMikuDance" if mmd_skeleton_map(list(motion.bones)) is not None else "unknown",
        "inverse_kinematics_off": sorted(switched_off),
    }  # fmt: skip


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
    """What the networks find on a person's mesh: the parts of its apparel, and the chains that are laid over them;
    nothing where there are none.
    """
    from bunraku.pipelines.clothes import clothed_of, rig_with_chains

    try:
        clothed = clothed_of(anatomy)
        if not clothed.apparel.any():
            return {}
        parts = _part_facts(anatomy.character, clothed)
        rig = rig_with_chains(anatomy, clothed=clothed)
    except CharacterError:  # nothing was found, or not on such a body
        return {}
    assert rig.character.rig is not None
    return {"apparel": parts} | _chain_facts(rig.chains, rig.character.rig.names)


def _part_facts(character: Character, clothed: Any) -> list[dict[str, Any]]:
    """Each part of the mask, and how the network takes it to swing."""
    import numpy as np

    from bunraku.apparel.chains.chain import parameters_beside
    from bunraku.apparel.chains.from_shape import with_parts_from_file
    from bunraku.apparel.clothed import FREE, LOADS, NARROW
    from bunraku.core.body.layout import JOINT_NAMES

    clothed = with_parts_from_file(clothed, parameters_beside(character))
    area = max(float(character.areas.sum()), 1e-30)
    out = []
    for number, kind in enumerate(clothed.kinds):
        rows = np.flatnonzero(clothed.part == number)
        joint = int(clothed.weights[rows].mean(axis=0).argmax())
        ratio = float(clothed.stiffness[number])
        turn = min(float(clothed.limit[number]), float(np.clip(10.0 ** (LOADS - ratio), NARROW, FREE)))
        out.append(
            {
                "part": number, "kind": kind, "vertices": len(rows),
                "area": round(float(character.areas[rows].sum()) / area, 4), "hangs_on": JOINT_NAMES[joint],
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
                "limit": round(float(np.degrees(chain.parameters.limit)), 1), "stiffness": chain.parameters.stiffness,
                "damping": chain.parameters.damping, "gravity": chain.parameters.gravity, "mass": chain.parameters.mass,
            }
            for chain in chains
        ]
    }  # fmt: skip


def say_chain(chain: dict[str, Any]) -> str:
    """A chain in words: what it was taken for."""
    return f"{chain['name']} ({chain['kind']}, {chain['links']} links on {chain['hangs_on']}, {_parameters(chain)})"


def say_part(part: dict[str, Any]) -> str:
    """A part in words."""
    return f"{part['kind']} on {part['hangs_on']} ({part['vertices']:,} vertices, {_parameters(part)})"


def _parameters(facts: dict[str, Any]) -> str:
    return f"turns {facts['limit']:g} degrees, stiffness {facts['stiffness']:g}, damping {facts['damping']:g}"


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
    """Write what is guessed about hair and clothes to a TOML file, for you to change. Of girl.obj, the file
    girl.apparel.toml beside it counts.
    """
    body: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Write what is guessed about axes, joints and pieces to a TOML file, for you to correct. Of girl.obj, the file
    girl.body.toml beside it counts.
    """
    overwrite: OverwriteOption = False

    def run(self) -> None:
        check_input(self.file)
        if self.views is not None:
            self._draw_views(self.views)
        for path in filter(None, (self.apparel, self.body)):
            check_output(path, (".toml",), [self.file])
            check_free([path], self.overwrite)
        facts = describe(self.file, self.unit)
        if self.apparel is not None:
            self._write_apparel(self.apparel, facts.get("chains", []))
        if self.body is not None:
            self._write_body(self.body, facts)
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
        self._wrote(path, SUFFIX)

    def _write_body(self, path: Path, facts: dict[str, Any]) -> None:
        from bunraku.core.body.corrections import SUFFIX, Corrections, read_corrections, write_corrections

        if "body_joints" not in facts:
            raise CharacterError(f"{self.file}: no body is found in it; leave out --body")
        axes = facts["orientation"]["taken_up"], facts["orientation"]["taken_front"]
        pieces = [(piece["kind"], piece["at"]) for piece in (*facts["pieces"], *facts["dress"])]
        said = read_corrections(self.file) or Corrections()
        write_corrections(path, said, axes, facts["body_joints"], pieces)
        self._wrote(path, SUFFIX)

    def _wrote(self, path: Path, suffix: str) -> None:
        note_written([path])
        if not self.json:
            wrote(path)
        counts = self.file.with_name(f"{self.file.stem}{suffix}")
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
    """What a file holds, in values that JSON can say; lengths in metres and seconds. FormatError where it cannot be
    read, CharacterError where it holds no mesh that can be animated.
    """
    facts: dict[str, Any] = {"file": str(path), "bytes": path.stat().st_size}
    if path.suffix.lower() in (".npz", ".npy", ".bvh", ".vrma"):
        return facts | _motion(path)
    from bunraku.core.files import read_bounded
    from bunraku.files import fbx_facts, holds_character, load_character

    if path.suffix.lower() == ".vmd":
        return facts | vmd_facts(path)
    fbx = fbx_facts(path, read_bounded(path)) if path.suffix.lower() == ".fbx" else {}
    if path.suffix.lower() in (".glb", ".fbx") and not holds_character(path):  # clips without a character
        return facts | _motion(path) | fbx
    character = load_character(path, unit="m" if unit == "auto" else unit)
    suffix = getattr(character.source, "suffix", path.suffix.lower())
    facts |= _character(character, unit)
    if character.source is not None:
        facts |= _document(character.source.document)
    if suffix not in GLTF:
        facts.pop("generator", None)  # the document stands for a file of another format
    up, front = facts["orientation"]["taken_up"], facts["orientation"]["taken_front"]
    return facts | _body(character, up, front, unit) | fbx | avatar_facts(character)


def _body(character: Character, up: str, front: str, unit: str) -> dict[str, Any]:
    """What moves it, what it stands on, which parts are found and how clearly, and what it cannot do: as `animate` has
    it.
    """
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.anatomy.corrected import joint_facts, piece_facts
    from bunraku.anatomy.scene import separated
    from bunraku.apparel.chains.moving import moving_rig
    from bunraku.apparel.parts import part_facts
    from bunraku.files import in_metres, rotated
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.apply import body_facts
    from bunraku.pipelines.requests import Request

    animator = Animator.shipped()
    try:
        in_unit = in_metres(rotated(character, up, front), "auto" if unit == "auto" else "m", "+y")[0]
        standing, lines = separated(in_unit)
        body = animator.body(standing, Request("walks"))
        anatomy, found = body.anatomy, body_facts(body.anatomy)
        dress = part_facts(standing)
    except (WeightsError, CharacterError) as error:
        return {"body": None, "body_note": str(error)}
    parts = [{"name": part.name, "area": round(part.area, 4), "clear": round(part.sure, 3)} for part in found.parts]
    facts: dict[str, Any] = {"beside": lines} if lines else {}
    moved = "30 handles" if body.parts is None else f"its own {len(body.parts.parts)} bones"
    facts |= {"moved_by": moved, "body": found.plan.words, "parts": parts, "cannot": list(found.cannot)}
    facts |= {"body_joints": joint_facts(anatomy.handles, anatomy.joints)}
    facts |= {"pieces": piece_facts(standing, anatomy.handles), "dress": dress}
    if moving_rig(character) is not None:  # the file has apparel
        return facts
    return facts | shape_facts(anatomy if body.parts is None else Anatomy.of(standing, animator.handles(standing)))


def _motion(path: Path) -> dict[str, Any]:
    from bunraku.core.motion import HandleMotion, SkeletalMotion
    from bunraku.files import read_motion
    from bunraku.pipelines.to_reference import creature_motion

    motion = read_motion(path)
    facts: dict[str, Any] = {"kind": "handle motion" if isinstance(motion, HandleMotion) else "skeletal motion"}
    facts |= {"frames": len(motion), "fps": float(motion.fps), "seconds": round(len(motion) / motion.fps, 3)}
    if isinstance(motion, HandleMotion):
        facts["handles"] = motion.translations.shape[1]
    elif isinstance(motion, SkeletalMotion):
        facts["joints"] = len(motion.skeleton.names)
        creature = creature_motion(motion)
        facts |= _mapping(motion.skeleton) | ({} if creature is None else {"body": creature.plan.words})
    travel = motion.root_translation[-1] - motion.root_translation[0]
    return facts | {"root_travel": [round(float(x), 3) for x in travel]}


def _mapping(skeleton: Skeleton) -> dict[str, Any]:
    """Which joints play the parts of a person, as far as that is found."""
    from bunraku.anatomy.names.skeleton_map import map_skeleton
    from bunraku.core.body.layout import JOINT_NAMES
    from bunraku.errors import MotionError

    try:
        mapped = map_skeleton(skeleton)
    except MotionError:
        return {"convention": "unknown", "mapping": {}}
    named = {name: skeleton.names[joint] for name, joint in zip(JOINT_NAMES, mapped.joints, strict=True) if joint >= 0}
    return {"convention": mapped.convention or "unknown", "mapping": named, "missing": list(mapped.missing)}


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
        "kind": "character", "name": character.name, "vertices": len(character.vertices), "vertices_welded": welded,
        "faces": len(character.faces), "loose_parts": parts, "height": _digits(height),
        "unit": _unit(height, suffix, unit), "extent": [_digits(x) for x in extent],
        "lowest_corner": [_digits(x) for x in low], "orientation": orientation, "rig": None,
    }  # fmt: skip
    if character.rig is not None:
        influences = int((character.rig.weights > 0).sum(axis=1).max(initial=0))
        names = list(character.rig.names)
        facts["rig"] = {"joints": len(names), "influences": influences, "names": names}
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
        axes = {"up": "+y", "front": "+z", "taken_up": "+y", "taken_front": "+z"}
        return {**axes, "up_confidence": None, "front_confidence": None, "note": f"assumed: {error}"}
    up, front, sure = resolved.up, resolved.front, (1.0, 1.0)
    if resolved.guess is None:
        note = f"up {up.upper()}, front {front.upper()}, as the file of corrections says"
    else:
        guess = resolved.guess
        up, front, sure = guess.up, guess.front, (guess.up_confidence, guess.front_confidence)
    return {
        "up": up, "front": front, "up_confidence": round(sure[0], 3), "front_confidence": round(sure[1], 3),
        "taken_up": resolved.up, "taken_front": resolved.front, "note": note,
    }  # fmt: skip


def _unit(height: float, suffix: str, unit: str) -> dict[str, str]:
    """What unit the file is likely to be in, and what animate and rig make of it."""
    from bunraku.files import UNIT_NAMES, resolve_unit

    resolved = resolve_unit(height, suffix, "auto")
    if unit != "auto":
        return {"name": UNIT_NAMES[unit], "note": ""}
    return {"name": UNIT_NAMES[resolved.likely], "note": resolved.note}


def _document(document: Document) -> dict[str, Any]:
    def named(kind: str) -> list[tuple[str, dict[str, Any]]]:
        """Entries of a kind, those without a name numbered."""
        return [
            (str(entry.get("name") or f"{kind[:-1]} {number}"), entry)
            for number, entry in enumerate(document.items(kind))
        ]

    def seconds(animation: dict[str, Any]) -> float:
        samplers = document.objects(animation, "samplers")
        ends = [float(document.accessor(sampler.get("input"), ("SCALAR",)).max(initial=0)) for sampler in samplers]
        return round(max(ends, default=0.0), 3)

    return {
        "generator": str(document.tree["asset"].get("generator", "")), "meshes": len(document.items("meshes")),
        "primitives": sum(len(document.objects(mesh, "primitives")) for mesh in document.items("meshes")),
        "materials": [name for name, _ in named("materials")],
        "textures": len(document.items("textures")), "skins": len(document.items("skins")),
        "animations": [
            {"name": name, "seconds": seconds(entry), "channels": len(document.objects(entry, "channels"))}
            for name, entry in named("animations")
        ],
        "extensions": sorted(str(name) for name in document.tree.get("extensionsUsed", [])),
    }  # fmt: skip


def _print(facts: dict[str, object]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for key, value in facts.items():
        table.add_row(Text(key.replace("_", " ")), Text(_WORDS.get(key, _plain)(value)))
    Console().print(table)


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return f"{len(value)}: {_short(value)}" if value else "none"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _orientation_words(value: Any) -> str:
    up, front = (
        f"{value[which].upper()} ({100 * min(value[which + '_confidence'], 0.99):.0f} % sure)"
        for which in ("up", "front")
    )
    return value["note"] or f"up {up}, front {front}"


def _rig_words(value: Any) -> str:
    if value is None:
        return "none"
    return f"{value['joints']} joints, up to {value['influences']} influences a vertex: {_short(value['names'])}"


def _mapping_words(value: Any) -> str:
    pairs = ", ".join(f"{name} = {joint}" for name, joint in value.items())
    return pairs or "none found; a person has a pelvis and two legs"


def _point_words(value: Any) -> str:
    return ", ".join(f"{x:g}" for x in value) + " m"


def _short(names: list[str], limit: int = 12) -> str:
    more = f", and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more


_WORDS: dict[str, Callable[[Any], str]] = {
    "bytes": size_text,
    "height": lambda value: f"{value:g} m",
    "seconds": lambda value: f"{value:g} s",
    "extent": lambda value: " x ".join(f"{x:g}" for x in value) + " m",
    "lowest_corner": _point_words,
    "root_travel": _point_words,
    "orientation": _orientation_words,
    "unit": lambda value: value["note"] or value["name"],
    "rig": _rig_words,
    "mapping": _mapping_words,
    "parts": lambda value: ", ".join(f"{part['name']} ({100 * part['clear']:.0f} % clear)" for part in value),
    "body_joints": lambda value: _short(list(value)),
    "dress": lambda value: _short(
        [f"{piece['kind']} on the {piece['carrier']} ({100 * piece['area']:.0f} %)" for piece in value]
    ),
    "pieces": lambda value: _short([f"{piece['kind']} ({100 * piece['area']:.0f} %)" for piece in value]),
    "beside": lambda value: "; ".join(value),
    "apparel": lambda value: _short([say_part(part) for part in value]),
    "chains": lambda value: _short([say_chain(chain) for chain in value]),
    "cannot": lambda value: "; ".join(value) or "nothing is known that it cannot do",
    "animations": lambda value: _short([f"{clip['name']} ({clip['seconds']:g} s)" for clip in value]) or "none",
    "deforms": lambda value: ", ".join(f"{kind} {count:,}" for kind, count in value.items()),
}
"""How a fact is printed; all others as numbers, texts or lists."""
