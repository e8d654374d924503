"""`bunraku transfer`: motion that exists already, put on any character, or many on many."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bunraku.cli import shared
from bunraku.cli.manifest import exclusive_output, fingerprint
from bunraku.cli.options import ApparelOptions, ProgramOption, StandingOptions, parse_jobs
from bunraku.core.files import open_once
from bunraku.core.request import Progress
from bunraku.errors import BunrakuError, FormatError, OptionError, sentence_of
from bunraku.pipelines.requests import TransferRequest
from bunraku.retarget.stages import Stages

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter
    from bunraku.core.character import Character, Handles
    from bunraku.files import Preset
    from bunraku.pipelines.transfer import Source


@dataclass(frozen=True)
class Transfer:
    """Put a motion on a character: BVH, AMASS, HumanML3D, FBX, a clip of a GLB, a folder of meshes, or what Bunraku
    wrote.

    A humanoid with a rig keeps its rig; everything else is moved by its 30 handles. One character with one motion
    writes a file; several of either write every pair into a folder. A file that holds a mesh is a character, unless it
    stands after --motions.

    For an engine, the motions as the clips of one character: bunraku transfer knight.glb walk.bvh run.bvh --for unity

    Example: bunraku transfer characters/*.glb motions/*.bvh -o out --jobs 2
    """

    files: tyro.conf.Positional[tuple[Path, ...]]
    """Characters and motions, in any order."""
    motions: tuple[Path, ...] = ()
    """Motions; with this, all other files are characters."""
    output: shared.OutputOption = ()
    """File to write, by its suffix, or the folder of several. May be given more than once for a single pair.
    Default: CHARACTER-MOTION.glb in this folder, or the folder transfer.
    """
    onto: Literal["auto", "handles", "rig"] = "auto"
    """What is moved: the "handles" of the character, the bones of its own "rig", or by "auto" the rig of a humanoid and
    the handles of others.
    """
    apparel: tyro.conf.OmitArgPrefixes[ApparelOptions] = field(default_factory=ApparelOptions)
    """How hair and clothes move."""
    handles: shared.HandlesOption = "predict"
    map: Path | None = None
    """A JSON file that names joints of the motion's skeleton: {"left_hip": "LeftUpLeg", ...}; see `bunraku inspect
    MOTION`.
    """
    clip: str = "0"
    """Number or name of the clip of a motion file with several."""
    fps: shared.FpsOption = 30.0
    without: shared.WithoutOption = ()
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
    overwrite: shared.OverwriteOption = False
    preview: shared.PreviewOption = ()
    standing: tyro.conf.OmitArgPrefixes[StandingOptions] = field(default_factory=StandingOptions)
    """How the characters' files are read."""

    def run(self) -> int:
        self.standing.check()
        Stages().without(self.without, "--without")
        self.request().check("--")
        shared.check_mask(self.apparel)
        with open_once() if len(self.files) + len(self.motions) == 2 else nullcontext():
            jobs, suffix = parse_jobs(self.jobs), _suffix(self.format)
            characters, motions, bad = self._sorted()
            if self.program is not None:
                _raise_first(bad)
                self._for(self.program, characters, motions)
                return 0
            if len(characters) == len(motions) == 1 and not bad and not self._folder():
                self._one(characters[0], motions[0], suffix)
                return 0
            if self.preview:
                raise OptionError(
                    "--preview is for one character with one motion; make previews of several files with "
                    "`bunraku render`"
                )
            return self._many(characters, motions, bad, jobs, suffix)

    @cached_property
    def names(self) -> dict[str, str]:
        """The map of joints."""
        return {} if self.map is None else _read_map(self.map)

    def request(self, handles: Handles | None = None, fitting: Stages | None = None) -> TransferRequest:
        """What is requested of each pair; `handles` are the character's where they are known."""
        return TransferRequest(
            self.onto, self.apparel, fitting, handles or self.handles, self.fps, self.names or None, self.clip
        )

    @property
    def saving(self) -> dict[str, str]:
        """Options of the format that is written, those that were given."""
        return {name: value for name, value in (("up", self.file_up), ("unit", self.file_unit)) if value}

    def settings(self) -> Transfer:
        """The same without what is no setting of a pair: what changes a result, with paths that hold in any folder."""
        mask = self.apparel.mask
        apparel = self.apparel if mask is None else replace(self.apparel, motion=str(mask.resolve()))
        return replace(
            self, files=(), motions=(), output=(), preview=(), jobs="1", overwrite=False, apparel=apparel,
            without=tuple(sorted(set(self.without))), map=None if self.map is None else self.map.resolve(),
        )  # fmt: skip

    def _folder(self) -> bool:
        """Whether an output is named as a folder."""
        return any(path.is_dir() or not path.suffix for path in self.output)

    def _sorted(self) -> tuple[list[Path], list[Path], dict[Path, str]]:
        """Characters, motions, and files that are neither with the reason; the last only beside others, so that one
        does not stop all.
        """
        from bunraku.files import holds_character

        characters: list[Path] = []
        motions: list[Path] = []
        bad: dict[Path, str] = {}
        given = [(path, False) for path in dict.fromkeys(self.files)]
        given += [(path, True) for path in dict.fromkeys(self.motions)]
        for path, named in given:
            try:
                if not self.motions:
                    (characters if holds_character(path) else motions).append(path)
                    continue
                if not (named and path.is_dir()):
                    shared.check_input(path)
                (motions if named else characters).append(path)
            except BunrakuError as error:
                bad[path] = str(error)
        if len(given) < 3 or not characters or not motions:
            _raise_first(bad)
        if not characters:
            raise OptionError("none of these files is a character; name at least one mesh, such as a .glb")
        if not motions:
            raise OptionError(
                "none of these files is a motion only; put motions that have a character in them after --motions"
            )
        return characters, motions, bad

    def _for(self, program: str, characters: list[Path], motions: list[Path]) -> None:
        """Write the clips of one character as a program wants them."""
        from bunraku.files import preset_named

        if len(characters) != 1:
            raise OptionError(f"--for writes the clips of one character; name one of these {len(characters)} at a time")
        options = (("--preview", self.preview), ("--file-up", self.file_up), ("--file-unit", self.file_unit))
        for option, value in (*options, ("--format", self.format != "glb"), ("--jobs", self.jobs != "1")):
            if value:
                raise OptionError(f"--for says what is written, and how; leave out {option}")
        row, (character,) = preset_named(program), characters
        named = self.output or (Path(f"{character.stem}-{row.name}{row.suffix}"),)
        names = names_of(motions)
        files = [file for path in named for file in row.files(path, names)]
        inputs = [character, *(motion for motion in motions if not motion.is_dir())]
        with exclusive_output(files), shared.stages() as report:
            shared.check_outputs(named, (), inputs, (row.suffix,), overwrite=True)
            shared.check_outputs(files, (), inputs, (row.suffix,), overwrite=self.overwrite)
            shared.check_written(self.apparel, files)
            shared.save_clips_to(clips_for(row, character, names, self, report), named, self.fps, False, report, row)

    def _one(self, character: Path, motion: Path, suffix: str) -> None:
        outputs = self.output or (Path(f"{character.stem}-{motion.stem}{suffix}"),)
        inputs = [character] if motion.is_dir() else [character, motion]
        with exclusive_output(map(shared.written_path, (*outputs, *self.preview))), shared.stages() as report:
            shared.check_outputs(outputs, self.preview, inputs, _outputs(), overwrite=self.overwrite)
            shared.check_written(self.apparel, outputs)
            animation = animation_of(Pair(outputs[0], (character, motion)), self, report)
            shared.save_all(animation, outputs, self.preview, self.fps, report, self.saving)

    def _many(
        self, characters: list[Path], motions: list[Path], bad: dict[Path, str], jobs: int | str, suffix: str
    ) -> int:
        from bunraku.files import check_writer

        if len(self.output) > 1:
            raise OptionError("several files go into one folder; name it with a single -o")
        folder = self.output[0] if self.output else Path("transfer")
        if folder.suffix and not folder.is_dir():
            if len(characters) == len(motions) == 1:  # a file was meant, and one input is bad
                _raise_first(bad)
            raise OptionError(
                f"{len(characters)} characters and {len(motions)} motions make several files; name a folder with -o, "
                f"not {folder}"
            )
        if folder.is_file():
            raise FormatError(folder, "this is a file; name a folder with -o, where each pair gets a file")
        shared.check_folder(folder)
        check_writer(Path(f"motion{suffix}"))
        shared.check_written(self.apparel, [Path(f"motion{suffix}")])
        settings = self.settings()
        pairs = pairs_of(characters, motions, folder, suffix, settings)
        inputs = {path.resolve() for path in (*characters, *motions)}
        for pair in pairs:
            if pair.path.resolve() in inputs:
                raise FormatError(pair.path, "this would overwrite the input; name another folder with -o")
        with exclusive_output(folders=[folder]):
            todo = shared.unfinished_results(pairs, self.overwrite, "files")
            with shared.stages() as report:
                work = partial(transfer_pairs, settings)
                status = shared.make_results(work, batches(todo, jobs), jobs, "transfer", report)
        shared.say_failed({str(path): reason for path, reason in bad.items()})
        return 1 if bad else status


def _raise_first(bad: dict[Path, str]) -> None:
    """Raise the first reason of files that cannot be used."""
    for path, reason in bad.items():
        raise FormatError(path, reason.removeprefix(f"{path}: "))


class Pair(shared.Result):
    """A character and a motion, its `inputs`, and the file to write."""


def pairs_of(
    characters: Iterable[Path], motions: Iterable[Path], folder: Path, suffix: str, settings: Transfer
) -> list[Pair]:
    """Every character with every motion, each with a file in a folder; files of one name get numbers."""
    options = {name: value for name, value in asdict(settings).items() if name != "map"}
    extra = [] if settings.map is None else [settings.map]
    out, names = [], set[str]()
    for character in characters:
        for motion in motions:
            name = plain = f"{character.stem}-{motion.stem}"
            number = 1
            while name.lower() in names:
                number += 1
                name = f"{plain}-{number}"
            names.add(name.lower())
            mark = fingerprint([character, motion, *extra], "transfer", suffix, options)
            out.append(Pair(folder / f"{name}{suffix}", (character, motion), mark))
    return out


_AT_ONCE = 4
"""Pairs of one character that a worker does at most before it reports them; chosen by eye."""


def batches(pairs: list[Pair], jobs: int | str) -> list[list[Pair]]:
    """Pairs of one character together, a few at once, so that progress is seen."""
    size = _AT_ONCE if jobs == "ray" else max(1, min(_AT_ONCE, len(pairs) // (2 * int(jobs))))
    out: list[list[Pair]] = []
    for pair in pairs:
        if out and len(out[-1]) < size and out[-1][0].inputs[0] == pair.inputs[0]:
            out[-1].append(pair)
        else:
            out.append([pair])
    return out


def animation_of(pair: Pair, settings: Transfer, progress: Progress | None = None) -> AnimatedCharacter:
    """The motion of a pair on its character, apparel and all; BunrakuError where a file cannot be read, the two do not
    go together, or there is nothing to simulate.
    """
    from bunraku.core.avatars import MmdModel
    from bunraku.files import check_writer
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.transfer import TRANSFER_STAGES, transferred

    character, handles = character_of(pair.inputs[0], settings)
    check_writer(pair.path, mmd=isinstance(character.avatar, MmdModel))
    request = settings.request(handles, TRANSFER_STAGES.without(settings.without))
    return transferred(Animator.shipped(progress), character, source_of(pair.inputs[1], settings), request)


def transfer_pairs(settings: Transfer, pairs: list[Pair]) -> Iterator[str]:
    """Make pairs, and give for each what went wrong, "" for nothing: a bad file does not stop the others."""
    for pair in pairs:
        reason = ""
        try:
            animation_of(pair, settings).save(pair.path, **settings.saving)
        except Exception as error:
            reason = sentence_of(error)
        yield reason


@lru_cache(maxsize=2)
def character_of(path: Path, settings: Transfer) -> tuple[Character, Handles | None]:
    """A character standing upright, and its handles where its rig is not moved."""
    from bunraku.core.avatars import mmd_model
    from bunraku.pipelines.animate import rig
    from bunraku.retarget.rig_parts import is_humanoid_rig

    character = settings.standing.load(path)
    bones = settings.onto == "rig" or (
        settings.onto == "auto" and (is_humanoid_rig(character) or mmd_model(character) is not None)
    )
    return character, None if bones else rig(character, handles=settings.handles)


@lru_cache(maxsize=16)
def source_of(path: Path, settings: Transfer) -> Source:
    """A motion, to be read when it is needed first."""
    from bunraku.pipelines.transfer import Source

    request = settings.request()
    return Source(path, request.fps, request.names, request.clip)


def names_of(motions: Iterable[Path]) -> dict[str, Path]:
    """Motions by the names of their clips: those of their files; a second one of a name gets a number."""
    from bunraku.files import free_name

    out: dict[str, Path] = {}
    for motion in motions:
        out[free_name(motion.stem or motion.name, out)] = motion
    return out


def clips_for(
    row: Preset, character: Path, motions: Mapping[str, Path], settings: Transfer, report: Progress
) -> dict[str, AnimatedCharacter]:
    """Each motion, by the name of its clip, on the character, as a program wants it; a person without a skeleton of its
    own gets the program's.
    """
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.pipelines.animator import Animator, Body
    from bunraku.pipelines.transfer import TRANSFER_STAGES, transferred
    from bunraku.retarget.engine_skeleton import on_skeleton

    report("load", 0.0)
    moved, handles = character_of(character, settings)
    if handles is not None and settings.onto == "auto":
        body = Body(moved, None, Anatomy.of(moved, handles).measured())
        if body.takes_skeleton:
            moved, handles, settings = on_skeleton(body.anatomy, row.skeleton), None, replace(settings, onto="rig")
    report("load", 1.0)
    request = settings.request(handles, TRANSFER_STAGES.without(settings.without))
    animator = Animator.shipped(report)
    return {
        name: transferred(animator, moved, source_of(motion, settings), request) for name, motion in motions.items()
    }


def _outputs() -> tuple[str, ...]:
    from bunraku.files import WRITERS

    return tuple(WRITERS["animation"])


def _suffix(text: str) -> str:
    suffix = f".{text.lower().removeprefix('.')}"
    if suffix not in _outputs():
        suffixes = ", ".join(suffix[1:] for suffix in _outputs())
        raise OptionError(f"--format names no format that is written: {text[:40]!r}; there are {suffixes}")
    return suffix


def _read_map(path: Path) -> dict[str, str]:
    """The map of joints in a JSON file."""
    shared.check_input(path)
    if path.stat().st_size > 1 << 20:
        raise FormatError(path, "a map of joints has less than 1 MiB; name the file that maps joints")
    try:
        names = json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError):
        raise FormatError(path, 'this is not JSON; write {"left_hip": "LeftUpLeg", ...}') from None
    if not isinstance(names, dict) or not all(isinstance(value, str) for value in names.values()):
        raise FormatError(path, 'a map of joints is an object of texts: {"left_hip": "LeftUpLeg", ...}')
    from bunraku.core.body.layout import JOINT_NAMES

    for name in names:
        if name not in JOINT_NAMES:
            raise FormatError(path, f"'{name[:40]}' is not one of SMPL's joints: {', '.join(JOINT_NAMES)}")
    return dict(sorted(names.items()))
