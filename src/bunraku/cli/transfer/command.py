"""`bunraku transfer`: motion that exists already, put on any character."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from bunraku.cli.options.orientation import AxisOption, UnitOption, check_axes
from bunraku.cli.options.sampling import ApparelOptions
from bunraku.cli.options.skeleton import ProgramOption
from bunraku.cli.output.alone import alone
from bunraku.cli.output.checks import check_folder, check_input, check_mask, check_written, written_path
from bunraku.cli.output.ledger import begin, note, still_to_do
from bunraku.cli.output.outputs import (
    OutputOption,
    PreviewOption,
    WithoutOption,
    check_outputs,
    check_stages,
    save_all,
    save_clips_to,
    wrote,
)
from bunraku.cli.output.progress import stages
from bunraku.cli.transfer.jobs import Pair, Settings, animation_of, holds_character, marks_of, pairs_of
from bunraku.cli.transfer.programs import clips_for, names_of
from bunraku.cli.transfer.runs import run_pairs
from bunraku.errors import BunrakuError, FormatError, OptionError
from bunraku.formats.files import open_once
from bunraku.nn.spread import parse_jobs

__all__ = ["Transfer"]


@dataclass(frozen=True)
class Transfer:
    """Put a motion on a character: BVH, AMASS, HumanML3D, FBX, a clip of a GLB, a folder of meshes, or what Bunraku
    wrote.

    A humanoid with a rig keeps its rig; everything else is moved by its 30 handles. One character with one motion
    writes a file, several of either write every pair into a folder. Files are told apart by what they hold; one that
    holds a mesh is a character unless it stands after --motions.

    For an engine, the motions as the clips of one character: bunraku transfer knight.glb walk.bvh run.bvh --for unity

    Example: bunraku transfer characters/*.glb motions/*.bvh -o out --jobs 2
    """

    files: tyro.conf.Positional[tuple[Path, ...]]
    """Characters and motions, in any order."""
    motions: tuple[Path, ...] = ()
    """Motions; with this, all other files are characters."""
    output: OutputOption = ()
    """File to write, by its suffix, or the folder of several. May be given more than once for a single pair.
    Default: CHARACTER-MOTION.glb in this folder, or the folder transfer.
    """
    onto: Literal["auto", "handles", "rig"] = "auto"
    """What is moved: the "handles" of the character, the bones of its own "rig", or by "auto" the rig of a humanoid and
    the handles of others.
    """
    apparel: tyro.conf.OmitArgPrefixes[ApparelOptions] = field(default_factory=ApparelOptions)
    """How hair and clothes move."""
    handles: Literal["predict", "rig"] = "predict"
    """Where handles come from: "predict" finds them from the shape, "rig" takes the bones that the file brings, by
    their names.
    """
    map: Path | None = None
    """A JSON file that names joints of the motion's skeleton: {"left_hip": "LeftUpLeg", ...}; see `bunraku inspect
    MOTION`.
    """
    clip: str = "0"
    """Number or name of the clip of a motion file with several."""
    fps: float = 30.0
    """Frames a second of the result, 1 to 240."""
    without: WithoutOption = ()
    up: AxisOption = "auto"
    """The axis that is up in the characters' files."""
    front: AxisOption = "auto"
    """The axis that the characters face in their files."""
    unit: UnitOption = "auto"
    """The unit of lengths in the characters' files."""
    file_up: Annotated[Literal["+y", "+z"] | None, tyro.conf.arg(help_behavior_hint="")] = None
    """The axis that is up in what is written, for BVH, USD, FBX, OBJ and PLY. Default: the format's own."""
    file_unit: Annotated[str | None, tyro.conf.arg(metavar="UNIT", help_behavior_hint="")] = None
    """The unit of lengths in what is written (m, dm, cm, mm, in, ft), for the same formats. Default: the format's own.
    """
    format: Annotated[str, tyro.conf.arg(metavar="SUFFIX")] = "glb"
    """What each pair is written as where no file is named: glb, vmd, vrma, bvh, usd, fbx, npz, obj, mp4 ..."""
    program: ProgramOption = None
    """Write the file that a program wants (docs/engines.md), with a clip for each motion, named after its file. Of one
    character; a person without a skeleton of its own gets the one that the program knows.
    """
    jobs: Annotated[str, tyro.conf.arg(metavar="{N,ray}")] = "1"
    """How many processes share the pairs, or "ray" for a Ray cluster."""
    overwrite: bool = False
    """Replace files that are there already and that Bunraku did not write, or made of something else."""
    preview: PreviewOption = ()
    """Also make a video (.mp4, .webp, .gif) or a contact sheet (.png), for a single pair. May be given more than once.
    """

    def run(self) -> int:
        check_axes(self.up, self.front)
        names = _names(self.map)
        check_stages(self.without)
        settings = Settings(
            self.onto, self.handles, self.fps, self.clip, names, tuple(sorted(set(self.without))), self.up, self.front,
            self.apparel, self.file_up or "", self.file_unit or "", self.unit,
        )  # fmt: skip
        settings.request().check("--")
        check_mask(self.apparel)
        with open_once() if len(self.files) + len(self.motions) == 2 else nullcontext():
            return self._made(settings, parse_jobs(self.jobs), _suffix(self.format))

    def _made(self, settings: Settings, jobs: int | str, suffix: str) -> int:
        characters, motions, bad = self._sorted()
        if self.program is not None:
            for path, reason in bad.items():
                raise FormatError(path, reason.removeprefix(f"{path}: "))
            self._for(self.program, characters, motions, settings)
            return 0
        single = len(characters) == len(motions) == 1 and not bad and not self._folder()
        if single:
            self._one(characters[0], motions[0], settings, suffix)
            return 0
        if self.preview:
            raise OptionError(
                "--preview is for one character with one motion; make previews of several files with `bunraku render`"
            )
        return self._many(characters, motions, bad, settings, jobs, suffix)

    def _folder(self) -> bool:
        """Whether an output is named as a folder."""
        return any(path.is_dir() or not path.suffix for path in self.output)

    def _sorted(self) -> tuple[list[Path], list[Path], dict[Path, str]]:
        """Characters, motions, and files that are neither with the reason; the last only beside others, so that one
        does not stop all.
        """
        characters: list[Path] = []
        motions: list[Path] = []
        bad: dict[Path, str] = {}
        given = [(path, False) for path in dict.fromkeys(self.files)] + [
            (path, True) for path in dict.fromkeys(self.motions)
        ]
        for path, named in given:
            try:
                if named:
                    if not path.is_dir():
                        check_input(path)
                    motions.append(path)
                elif self.motions:
                    check_input(path)
                    characters.append(path)
                else:
                    (characters if holds_character(path) else motions).append(path)
            except BunrakuError as error:
                bad[path] = str(error)
        if bad and (len(given) < 3 or not characters or not motions):
            raise FormatError(*next((path, reason.removeprefix(f"{path}: ")) for path, reason in bad.items()))
        if not characters:
            raise OptionError("none of these files is a character; name at least one mesh, such as a .glb")
        if not motions:
            raise OptionError(
                "none of these files is a motion only; put motions that have a character in them after --motions"
            )
        return characters, motions, bad

    def _for(self, program: str, characters: list[Path], motions: list[Path], settings: Settings) -> None:
        """Write the clips of one character as a program wants them."""
        from bunraku.io.presets import preset_named

        if len(characters) != 1:
            raise OptionError(f"--for writes the clips of one character; name one of these {len(characters)} at a time")
        said = (("--preview", self.preview), ("--file-up", self.file_up), ("--file-unit", self.file_unit))
        for option, value in (*said, ("--format", self.format != "glb"), ("--jobs", self.jobs != "1")):
            if value:
                raise OptionError(f"--for says what is written, and how; leave out {option}")
        row, (character,) = preset_named(program), characters
        named = self.output or (Path(f"{character.stem}-{row.name}{row.suffix}"),)
        names = names_of(motions)
        files = [file for path in named for file in row.files(path, names)]
        inputs = [character, *(motion for motion in motions if not motion.is_dir())]
        with alone(files), stages() as report:
            check_outputs(named, (), inputs, (row.suffix,), overwrite=True)
            check_outputs(files, (), inputs, (row.suffix,), overwrite=self.overwrite)
            check_written(self.apparel, files)
            save_clips_to(clips_for(row, character, motions, settings, report), named, self.fps, False, report, row)

    def _one(self, character: Path, motion: Path, settings: Settings, suffix: str) -> None:
        outputs = self.output or (Path(f"{character.stem}-{motion.stem}{suffix}"),)
        inputs = [character] if motion.is_dir() else [character, motion]
        with alone(written_path(path) for path in (*outputs, *self.preview)), stages() as report:
            check_outputs(outputs, self.preview, inputs, _outputs(), overwrite=self.overwrite)
            check_written(self.apparel, outputs)
            animation = animation_of(Pair(character, motion, outputs[0]), settings, report)
            save_all(animation, outputs, self.preview, self.fps, report, settings.saving)

    def _many(
        self,
        characters: list[Path],
        motions: list[Path],
        bad: dict[Path, str],
        settings: Settings,
        jobs: int | str,
        suffix: str,
    ) -> int:
        from bunraku.io.registry import check_writer

        if len(self.output) > 1:
            raise OptionError("several files go into one folder; name it with a single -o")
        folder = self.output[0] if self.output else Path("transfer")
        if folder.suffix and not folder.is_dir():
            if len(characters) == len(motions) == 1 and bad:  # a file was meant, and one input is no good
                path, reason = next(iter(bad.items()))
                raise FormatError(path, reason.removeprefix(f"{path}: "))
            raise OptionError(
                f"{len(characters)} characters and {len(motions)} motions make several files; name a folder with -o, "
                f"not {folder}"
            )
        if folder.is_file():
            raise FormatError(folder, "this is a file; name a folder with -o, where each pair gets a file")
        check_folder(folder)
        check_writer(Path(f"motion{suffix}"))
        check_written(self.apparel, [Path(f"motion{suffix}")])
        pairs = pairs_of(characters, motions, folder, suffix)
        inputs = {path.resolve() for path in (*characters, *motions)}
        for pair in pairs:
            if pair.output.resolve() in inputs:
                raise FormatError(pair.output, "this would overwrite the input; name another folder with -o")
        with alone(folders=[folder]):
            return self._fill(pairs, bad, settings, jobs)

    def _fill(self, pairs: list[Pair], bad: dict[Path, str], settings: Settings, jobs: int | str) -> int:
        """Do the pairs whose files are not there yet."""
        marks = marks_of(pairs, settings)
        left = set(still_to_do(marks, self.overwrite))
        todo = [pair for pair in pairs if pair.written in left]
        if len(todo) < len(pairs):
            print(f"{len(pairs) - len(todo)} of {len(pairs)} files are there already")
        failed: dict[str, str] = {str(path): reason for path, reason in bad.items()}
        if todo:
            todo[0].output.parent.mkdir(exist_ok=True)
            begin({pair.written: marks[pair.written] for pair in todo})
        with stages() as report:
            for done, (pair, reason) in enumerate(run_pairs(todo, settings, jobs), 1):
                if reason:
                    failed[_label(pair, reason)] = reason
                    note(pair.written, "")  # nothing was made: what comes to lie there is another's
                else:
                    note(pair.written, marks[pair.written])
                    wrote(pair.written)
                report("transfer", done / len(todo))
        for label, reason in failed.items():
            print(f"bunraku: failed: {label}: {' '.join(reason.removeprefix(f'{label}: ').split())}", file=sys.stderr)
        return 1 if failed else 0


def _label(pair: Pair, reason: str) -> str:
    """The file that is at fault, or the pair where neither is named."""
    return next(
        (str(path) for path in (pair.character, pair.motion) if reason.startswith(f"{path}: ")),
        f"{pair.character} with {pair.motion}",
    )


def _outputs() -> tuple[str, ...]:
    from bunraku.io.table import FORMATS

    return tuple(suffix for found in FORMATS if found.animation for suffix in found.suffixes)


def _suffix(text: str) -> str:
    suffix = f".{text.lower().removeprefix('.')}"
    if suffix not in _outputs():
        known = ", ".join(known[1:] for known in _outputs())
        raise OptionError(f"--format names no format that is written: {text[:40]!r}; there are {known}")
    return suffix


def _names(path: Path | None) -> tuple[tuple[str, str], ...]:
    """The map of joints in a JSON file."""
    if path is None:
        return ()
    check_input(path)
    if path.stat().st_size > 1 << 20:
        raise FormatError(path, "a map of joints has less than 1 MiB; name the file that maps joints")
    try:
        names = json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError):
        raise FormatError(path, 'this is no JSON; write {"left_hip": "LeftUpLeg", ...}') from None
    if not isinstance(names, dict) or not all(isinstance(value, str) for value in names.values()):
        raise FormatError(path, 'a map of joints is an object of texts: {"left_hip": "LeftUpLeg", ...}')
    from bunraku.body.layout import JOINT_NAMES

    for name in names:
        if name not in JOINT_NAMES:
            raise FormatError(path, f"'{name[:40]}' is none of SMPL's joints: {', '.join(JOINT_NAMES)}")
    return tuple(sorted(names.items()))
