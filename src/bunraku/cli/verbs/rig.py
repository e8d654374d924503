"""`bunraku rig`: the character with its handles as a skin, without motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from bunraku.cli.options.orientation import AxisOption, UnitOption, check_axes, stand_up
from bunraku.cli.options.skeleton import SkeletonOption
from bunraku.cli.output.alone import alone
from bunraku.cli.output.checks import check_different, check_input, check_output, make_folder
from bunraku.cli.output.ledger import check_free, note_written
from bunraku.cli.output.outputs import OutputOption, wrote
from bunraku.cli.output.progress import stages

__all__ = ["Rig"]


@dataclass(frozen=True)
class Rig:
    """Give a character its 30 handles as a skin, without motion.

    Any 3D program can pose the result: handle 0 is the root, the others are its children, four weights a vertex.

    Example: bunraku rig dragon.glb -o dragon-rigged.glb --preview dragon-handles.png
    """

    character: tyro.conf.Positional[Path]
    """The mesh to rig."""
    output: OutputOption = ()
    """GLB or FBX to write. May be given more than once. Default: CHARACTER-rigged.glb in this folder."""
    preview: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Also make a page (.png) that shows what was decided: the front and the back coloured by handle, how the character
    stands, which parts were found and how clearly, and what such a body cannot do.
    """
    handles: Literal["predict", "rig"] = "predict"
    """Where the handles come from: "predict" finds them from the shape, "rig" takes the bones that the file brings, by
    their names.
    """
    skeleton: SkeletonOption = None
    """Write a tree of joints in a T-pose with the names of Mixamo, VRM or Unreal in place of the handles, which
    engines' humanoid retargeting takes. For persons.
    """
    overwrite: bool = False
    """Replace files that are there already and that Bunraku did not write."""
    up: AxisOption = "auto"
    """The axis that is up in the file. "auto" goes by the rule of the format, and by the shape where it has none."""
    front: AxisOption = "auto"
    """The axis that the character faces in the file."""
    unit: UnitOption = "auto"
    """The unit of lengths in the file. "auto" goes by the rule of the format, and by the height where it has none."""

    def run(self) -> None:
        check_axes(self.up, self.front)
        check_input(self.character)
        outputs = self.output or (Path(f"{self.character.stem}-rigged.glb"),)
        previews = () if self.preview is None else (self.preview,)
        with alone((*outputs, *previews)):
            for path in outputs:
                check_output(path, (".glb", ".fbx"), [self.character])
            for path in previews:
                check_output(path, (".png",), [self.character])
            check_different((*outputs, *previews))
            check_free((*outputs, *previews), self.overwrite)
            self._make(outputs)

    def _make(self, outputs: tuple[Path, ...]) -> None:
        """Make the handles and write the files."""
        from bunraku.io import load_character, save_character

        written: list[Path] = []
        with stages() as report:
            report("load", 0.0)
            given = load_character(self.character, unit="m")
            character = stand_up(given, self.character, self.up, self.front, self.unit)
            report("load", 1.0)

            from bunraku.anatomy.anatomy import Anatomy
            from bunraku.pipelines.animate import rig
            from bunraku.pipelines.bodies import body_facts

            handles = rig(character, handles=self.handles, progress=report)
            anatomy = Anatomy.of(character, handles)
            facts, joints = body_facts(anatomy), f"{len(handles.positions)} handles"
            shown, joined = character, True
            if self.skeleton is not None:
                from bunraku.retarget.engine_skeleton import on_skeleton

                shown, joined = on_skeleton(anatomy, self.skeleton), False
                assert shown.rig is not None
                joints = f"{len(shown.rig.names)} joints"
            try:
                for number, path in enumerate(outputs):
                    report("write", number / len(outputs))
                    written.append(save_character(shown, path, handles if joined else None, rig=not joined))
                report("write", 1.0)
                if self.preview is not None:
                    from bunraku.cli.options.orientation import stands_line
                    from bunraku.render import save_still

                    make_folder(self.preview)
                    lines = [stands_line(given, self.up, self.front), f"height: {character.height:.3g} m", *facts.lines]
                    written.append(save_still(character, self.preview, handles, views=2, lines=lines))
            finally:  # what is whole stays
                note = f"{joints}, {facts.plan.words}"
                for path in written:
                    wrote(path, note if path in outputs else "")
                note_written(written)
