"""`bunraku transfer --for`: motions on one character as the clips that a program takes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.cli.output.progress import Report
from bunraku.cli.transfer.jobs import Settings, character_of, source_of, stages_of

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter
    from bunraku.io.presets import Preset

__all__ = ["clips_for", "names_of"]


def names_of(motions: Iterable[Path]) -> dict[str, Path]:
    """Motions by the names of their clips: those of their files; one that is there already gets a number."""
    from bunraku.formats.gltf.carry_clips import free_name

    out: dict[str, Path] = {}
    for motion in motions:
        out[free_name(motion.stem or motion.name, out)] = motion
    return out


def clips_for(
    row: Preset, character: Path, motions: Sequence[Path], settings: Settings, report: Report
) -> dict[str, AnimatedCharacter]:
    """Each motion on the character, by its name; a person without a skeleton of its own gets the program's.

    Args:
        row: What the program wants.
        character: The file of the character.
        motions: Files of the motions.
        settings: How they are put on it.
        report: Called with a stage's name and the share done.

    Raises:
        BunrakuError: A file cannot be read, or the two do not go together.
    """
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.pipelines.animator import Animator, Body
    from bunraku.pipelines.transfer import transferred
    from bunraku.retarget.engine_skeleton import on_skeleton

    report("load", 0.0)
    moved, handles = character_of(character, settings)
    if handles is not None and settings.onto == "auto":
        body = Body(moved, None, Anatomy.of(moved, handles).measured())
        if body.takes_skeleton:
            moved, handles, settings = on_skeleton(body.anatomy, row.skeleton), None, replace(settings, onto="rig")
    report("load", 1.0)
    request = replace(settings.request(handles), stages=stages_of(settings))
    animator = Animator.shipped(report)
    return {
        name: transferred(animator, moved, source_of(motion, settings), request)
        for name, motion in names_of(motions).items()
    }
