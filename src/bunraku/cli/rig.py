"""`bunraku rig`: the character with its handles as a skin, without motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.cli import shared
from bunraku.cli.manifest import check_free, exclusive_output
from bunraku.cli.options import FeelOption, SkeletonOption, StandingOptions
from bunraku.core.request import GRAVITY, STIFFNESS
from bunraku.errors import BunrakuError, OptionError
from bunraku.pipelines.requests import Apparel

if TYPE_CHECKING:
    import numpy as np

    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.apparel.chains.chain_rig import Chained
    from bunraku.core.avatars import MmdModel, VrmModel
    from bunraku.core.character import Character

_SKELETONS = {".vrm": "vrm", ".pmx": "vrm"}
"""Whose skeleton a format has that knows no handles."""


@dataclass(frozen=True, eq=False)
class _Shown:
    """What is written: a character, its chains where it has some, and what that is in words."""

    character: Character
    chains: Chained | None
    bare: bool
    words: str

    @classmethod
    def of(
        cls, anatomy: Anatomy, skeleton: str | None, apparel: bool, mask: np.ndarray | None, stiffness: float,
        gravity: float,
    ) -> _Shown:  # fmt: skip
        from bunraku.pipelines.clothes import rig_with_chains
        from bunraku.retarget.engine_skeleton import on_skeleton

        handles = len(anatomy.handles.positions)
        if apparel:
            chain_rig = rig_with_chains(anatomy, skeleton, mask, stiffness, gravity)
            assert chain_rig.character.rig is not None
            words = f"{len(chain_rig.character.rig.names)} bones, {len(chain_rig.chains)} chains of hair and clothes"
            return cls(chain_rig.character, chain_rig, False, words)
        if skeleton is None:
            return cls(anatomy.character, None, True, f"{handles} handles")
        shown = on_skeleton(anatomy, skeleton)
        assert shown.rig is not None
        return cls(shown, None, False, f"{len(shown.rig.names)} joints")

    @classmethod
    def kept(cls, character: Character, suffix: str) -> _Shown | None:
        """A character with the bones and the physics that its file brings, for a file of the same kind; None where it
        brings none.
        """
        from bunraku.apparel.physics.rig import apparel_rig
        from bunraku.core.avatars import mmd_model, vrm_model

        models = {".pmx": mmd_model, ".vrm": vrm_model}
        if suffix not in models or models[suffix](character) is None or apparel_rig(character) is None:
            return None
        assert character.rig is not None
        return cls(
            character, None, False, f"its own {len(character.rig.names)} bones, and the physics of its file kept"
        )

    def avatar(self, suffix: str) -> MmdModel | VrmModel | None:
        """What a format holds of chains."""
        if self.chains is None or suffix not in (".vrm", ".glb", ".pmx"):
            return None
        from bunraku.apparel.chains.avatars import mmd_avatar, vrm_avatar

        return mmd_avatar(self.chains) if suffix == ".pmx" else vrm_avatar(self.chains)


@dataclass(frozen=True)
class Rig:
    """Give a character its 30 handles as a skin, without motion.

    Any 3D program can pose the result: handle 0 is the root, the others are its children, four weights a vertex.

    Example: bunraku rig dragon.glb -o dragon-rigged.glb --preview dragon-handles.png
    """

    character: tyro.conf.Positional[Path]
    """The mesh to rig."""
    output: shared.OutputOption = ()
    """GLB, FBX, VRM or PMX to write. May be given more than once; one that is refused does not keep the others from
    being written. Default: CHARACTER-rigged.glb in this folder. A VRM has a skeleton with VRM's names, a PMX one with
    any.
    """
    preview: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Also make a page (.png) that shows what was decided: the front and the back coloured by handle, how the character
    stands, which parts were found and how clearly, and what such a body cannot do.
    """
    handles: shared.HandlesOption = "predict"
    skeleton: SkeletonOption = None
    apparel: Annotated[str, tyro.conf.arg(metavar="{none,auto,MASK}")] = "none"
    """Give hair and clothes bones of their own: "auto" where the file's physics or else a network find any, or where a
    mask (.npy, .txt, painted .ply or .glb) says. A VRM gets springs and colliders for them, a PMX rigid bodies and
    joints, a GLB springs in its extras. A VRM or PMX that has physics keeps its bones and its physics in a file of the
    same kind.
    """
    stiffness: FeelOption = 1.0
    gravity: float = 1.0
    """How strongly apparel is drawn downwards, as a factor, 0 to 10."""
    overwrite: shared.OverwriteOption = False
    standing: tyro.conf.OmitArgPrefixes[StandingOptions] = field(default_factory=StandingOptions)
    """How the character's file is read."""

    def run(self) -> None:
        self.standing.check()
        shared.check_input(self.character)
        outputs = self.output or (Path(f"{self.character.stem}-rigged.glb"),)
        previews = () if self.preview is None else (self.preview,)
        if self.apparel not in ("none", "auto"):
            Apparel(self.apparel).check("--")
            shared.check_input(Path(self.apparel))
        STIFFNESS.check(self.stiffness, "--apparel-feel")
        GRAVITY.check(self.gravity, "--gravity")
        with exclusive_output((*outputs, *previews)):
            for path in outputs:
                shared.check_output(path, (".glb", ".fbx", ".vrm", ".pmx"), [self.character])
            for path in previews:
                shared.check_output(path, (".png",), [self.character])
            shared.check_different((*outputs, *previews))
            check_free((*outputs, *previews), self.overwrite)
            self._make(outputs)

    def _make(self, outputs: tuple[Path, ...]) -> None:
        """Make the handles and write the files."""
        from bunraku.files import load_character, save_character

        with shared.stages() as report:
            report("load", 0.0)
            given = load_character(self.character, unit="m")
            character = self.standing.stood(given, self.character)
            report("load", 1.0)

            from bunraku.anatomy.anatomy import Anatomy
            from bunraku.pipelines.animate import rig
            from bunraku.pipelines.apply import body_facts

            handles = rig(character, handles=self.handles, progress=report)
            anatomy = Anatomy.of(character, handles)
            facts = body_facts(anatomy)
            skeletons = {path: self.skeleton or _SKELETONS.get(path.suffix.lower()) for path in outputs}
            mask = None
            if self.apparel not in ("none", "auto"):
                from bunraku.apparel.mask import read_artist_mask

                mask = read_artist_mask(self.apparel, character)
            made, problems = dict[str | None, _Shown](), dict[Path, BunrakuError]()
            notes: dict[Path, str] = {}
            with shared.written_files(lambda path: notes.get(path, "")) as written:
                for number, (path, name) in enumerate(skeletons.items()):
                    report("write", number / len(outputs))
                    try:
                        suffix, asked = path.suffix.lower(), self.apparel != "none"
                        shown = _Shown.kept(character, suffix) if self.apparel == "auto" and not self.skeleton else None
                        if shown is None:
                            made[name] = shown = made.get(name) or _Shown.of(
                                anatomy, name, asked, mask, self.stiffness, self.gravity
                            )
                        written.append(
                            save_character(
                                shown.character, path, handles if shown.bare else None, rig=not shown.bare,
                                avatar=shown.avatar(suffix),
                            )
                        )  # fmt: skip
                        notes[path] = f"{shown.words}, {facts.plan.words}"
                    except BunrakuError as error:
                        if len(outputs) == 1:
                            raise
                        problems[path] = error
                report("write", 1.0)
                if self.preview is not None:
                    from bunraku.cli.options import stands_line
                    from bunraku.core.files import check_output_folder
                    from bunraku.render import save_still

                    check_output_folder(self.preview)
                    stands = stands_line(given, self.standing.up, self.standing.front)
                    lines = [stands, f"height: {character.height:.3g} m", *facts.lines]
                    written.append(save_still(character, self.preview, handles, views=2, lines=lines))
            if problems:
                reasons = (
                    f"{path} was not written: {str(problems[path]).removeprefix(f'{path}: ')}" for path in problems
                )
                raise OptionError("\n".join(reasons))
