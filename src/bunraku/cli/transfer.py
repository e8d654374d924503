"""`bunraku transfer`: motion that exists already, put on any character, or many on many."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bunraku.cli.manifest import exclusive_output, fingerprint, note_begun, note_done, unfinished
from bunraku.cli.options import ApparelOptions, AxisOption, ProgramOption, UnitOption, check_axes
from bunraku.cli.outputs import (
    OutputOption,
    PreviewOption,
    Report,
    WithoutOption,
    check_folder,
    check_input,
    check_mask,
    check_outputs,
    check_stages,
    check_written,
    save_all,
    save_clips_to,
    stages,
    written_path,
    wrote,
)
from bunraku.core.files import open_once
from bunraku.core.parallel import parse_jobs, run_parallel
from bunraku.errors import BunrakuError, FormatError, OptionError
from bunraku.pipelines.requests import Apparel, TransferRequest

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter
    from bunraku.core.character import Character, Handles
    from bunraku.files import Preset
    from bunraku.pipelines.transfer import Source
    from bunraku.retarget.fit import Stages

__all__ = [
    "Pair", "Settings", "Transfer", "animation_of", "clips_for", "holds_character", "marks_of", "names_of",
    "pairs_of", "run_pairs", "transfer_pair",
]  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is the same for all pairs of a batch; the fields are options of `bunraku transfer`."""

    onto: Literal["auto", "handles", "rig"] = "auto"
    handles: Literal["predict", "rig"] = "predict"
    fps: float = 30.0
    clip: str = "0"
    names: tuple[tuple[str, str], ...] = ()
    without: tuple[str, ...] = ()
    up: str = "auto"
    front: str = "auto"
    apparel: Apparel = field(default_factory=Apparel)
    file_up: str = ""
    file_unit: str = ""
    unit: str = "auto"

    def request(self, handles: Handles | None = None) -> TransferRequest:
        """What is requested of each pair.

        Args:
            handles: The character's, where they are known.
        """
        clip = int(self.clip) if self.clip.isdecimal() else self.clip
        return TransferRequest(
            self.onto, self.apparel, None, handles or self.handles, self.fps, dict(self.names) or None, clip
        )

    @property
    def saving(self) -> dict[str, str]:
        """Options of the format that is written, those that were given."""
        return {name: value for name, value in (("up", self.file_up), ("unit", self.file_unit)) if value}


@dataclass(frozen=True)
class Pair:
    """A character, a motion and the file to write."""

    character: Path
    motion: Path
    output: Path

    @property
    def written(self) -> Path:
        """What is there when it is done: the file, or the folder of a sequence of meshes."""
        return written_path(self.output)


def holds_character(path: Path) -> bool:
    """Whether a file holds a character, with or without clips, and not only a motion. Folders hold frames of a moving
    mesh.

    Raises:
        FormatError: The file is missing, or its kind is unknown.
    """
    from bunraku.core.files import check_input, open_input
    from bunraku.files import detect

    if path.is_dir():
        return False
    size = check_input(path)
    with open_input(path) as file:
        start = file.read(64)
        try:
            detect(path, start, "character")
        except FormatError:
            if path.suffix.lower() != ".vmd":
                detect(path, start, "motion")
            return False
        gltf, fbx = start.startswith(b"glTF") or path.suffix.lower() == ".gltf", path.suffix.lower() == ".fbx"
        if not gltf and not fbx:
            return True
        file.seek(0)
        data = file.read(size)
    if gltf:
        from bunraku.files import open_document

        return bool(open_document(path, data).items("meshes"))
    from bunraku.files import fbx_facts

    return bool(fbx_facts(path, data)["meshes"])


def pairs_of(characters: Iterable[Path], motions: Iterable[Path], folder: Path, suffix: str = ".glb") -> list[Pair]:
    """Every character with every motion, each with a file of its own in a folder; files of one name get numbers."""
    out, names = [], set[str]()
    for character in characters:
        for motion in motions:
            name = plain = f"{character.stem}-{motion.stem}"
            number = 1
            while name.lower() in names:
                number += 1
                name = f"{plain}-{number}"
            names.add(name.lower())
            out.append(Pair(character, motion, folder / f"{name}{suffix}"))
    return out


def animation_of(
    pair: Pair, settings: Settings, progress: Callable[[str, float], None] | None = None
) -> AnimatedCharacter:
    """The motion of a pair on its character, apparel and all.

    Raises:
        BunrakuError: A file cannot be read, the two do not go together, or there is nothing to simulate.
    """
    from bunraku.files import check_writes
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.transfer import transferred

    character, handles = character_of(pair.character, settings)
    check_writes(pair.output, character)
    request = replace(settings.request(handles), stages=stages_of(settings))
    return transferred(Animator.shipped(progress), character, source_of(pair.motion, settings), request)


def transfer_pair(pair: Pair, settings: Settings) -> str:
    """Do one pair.

    Returns:
        "" when it is written, otherwise what went wrong.
    """
    try:
        animation_of(pair, settings).save(pair.output, **settings.saving)
    except BunrakuError as error:
        return str(error)
    except MemoryError:
        return (
            f"{pair.character.name} with {pair.motion.name}: the memory is not enough for this; simplify the "
            f"mesh or cut the motion"
        )
    except Exception as error:  # one bad file must not stop the others
        return (
            f"{pair.character.name} with {pair.motion.name}: this is a fault of Bunraku, not yours: "
            f"{type(error).__name__}: {error}"
        )
    return ""


@lru_cache(maxsize=2)
def character_of(path: Path, settings: Settings) -> tuple[Character, Handles | None]:
    """A character standing upright, and its handles where its rig is not moved."""
    from bunraku.cli.options import stand_up
    from bunraku.core.avatars import mmd_model
    from bunraku.files import load_character
    from bunraku.pipelines.animate import rig
    from bunraku.retarget.rig_parts import is_humanoid_rig

    character = stand_up(load_character(path, unit="m"), path, settings.up, settings.front, settings.unit)
    bones = settings.onto == "rig" or (
        settings.onto == "auto" and (is_humanoid_rig(character) or mmd_model(character) is not None)
    )
    return character, None if bones else rig(character, handles=settings.handles)


@lru_cache(maxsize=16)
def source_of(path: Path, settings: Settings) -> Source:
    """A motion, to be read when it is needed first."""
    from bunraku.pipelines.transfer import Source

    request = settings.request()
    return Source(path, request.fps, request.names, request.clip)


def stages_of(settings: Settings) -> Stages:
    from bunraku.pipelines.transfer import TRANSFER_STAGES

    return replace(TRANSFER_STAGES, **{name.replace("-", "_"): False for name in settings.without})


def marks_of(pairs: Iterable[Pair], settings: Settings) -> dict[Path, str]:
    """The fingerprint of what each pair writes."""
    return {
        pair.written: fingerprint([pair.character, pair.motion], "transfer", pair.output.suffix, asdict(settings))
        for pair in pairs
    }


def names_of(motions: Iterable[Path]) -> dict[str, Path]:
    """Motions by the names of their clips: those of their files; one that is there already gets a number."""
    from bunraku.files import free_name

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


_AT_ONCE = 4
"""Pairs of one character that a worker does at most before it reports them."""


def run_pairs(pairs: list[Pair], settings: Settings, jobs: int | str) -> Iterator[tuple[Pair, str]]:
    """Do all pairs; give each with what went wrong, "" for nothing, as it is done.

    Args:
        pairs: What to do; pairs of one character follow each other.
        settings: For all.
        jobs: How many processes, or "ray" for a cluster of the package ray, whose machines must see the same files.

    Raises:
        MissingExtraError: ray is not installed.
    """
    if jobs == 1 or (len(pairs) <= 1 and jobs != "ray"):
        for pair in pairs:
            yield pair, transfer_pair(pair, settings)
        return
    own = {_resolved(pair) if jobs == "ray" else pair: pair for pair in pairs}
    size = _AT_ONCE if jobs == "ray" else max(1, min(_AT_ONCE, len(pairs) // (2 * int(jobs))))
    for pair, reason in run_parallel(partial(_run_batch, settings), _batches(list(own), size), jobs, str):
        yield own[pair], reason


def _resolved(pair: Pair) -> Pair:
    """The same for workers that run in folders of their own."""
    return Pair(pair.character.resolve(), pair.motion.resolve(), pair.output.resolve())


def _batches(pairs: list[Pair], size: int) -> list[list[Pair]]:
    """Pairs of one character together, a few at once, so that progress is seen."""
    out: list[list[Pair]] = []
    for pair in pairs:
        if out and len(out[-1]) < size and out[-1][0].character == pair.character:
            out[-1].append(pair)
        else:
            out.append([pair])
    return out


def _run_batch(settings: Settings, batch: list[Pair]) -> list[str]:
    return [transfer_pair(pair, settings) for pair in batch]


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
        from bunraku.files import preset_named

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
        with exclusive_output(files), stages() as report:
            check_outputs(named, (), inputs, (row.suffix,), overwrite=True)
            check_outputs(files, (), inputs, (row.suffix,), overwrite=self.overwrite)
            check_written(self.apparel, files)
            save_clips_to(clips_for(row, character, motions, settings, report), named, self.fps, False, report, row)

    def _one(self, character: Path, motion: Path, settings: Settings, suffix: str) -> None:
        outputs = self.output or (Path(f"{character.stem}-{motion.stem}{suffix}"),)
        inputs = [character] if motion.is_dir() else [character, motion]
        with exclusive_output(written_path(path) for path in (*outputs, *self.preview)), stages() as report:
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
        from bunraku.files import check_writer

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
        with exclusive_output(folders=[folder]):
            return self._fill(pairs, bad, settings, jobs)

    def _fill(self, pairs: list[Pair], bad: dict[Path, str], settings: Settings, jobs: int | str) -> int:
        """Do the pairs whose files are not there yet."""
        marks = marks_of(pairs, settings)
        left = set(unfinished(marks, self.overwrite))
        todo = [pair for pair in pairs if pair.written in left]
        if len(todo) < len(pairs):
            print(f"{len(pairs) - len(todo)} of {len(pairs)} files are there already")
        failed: dict[str, str] = {str(path): reason for path, reason in bad.items()}
        if todo:
            todo[0].output.parent.mkdir(exist_ok=True)
            note_begun({pair.written: marks[pair.written] for pair in todo})
        with stages() as report:
            for done, (pair, reason) in enumerate(run_pairs(todo, settings, jobs), 1):
                if reason:
                    failed[_label(pair, reason)] = reason
                    note_done(pair.written, "")  # nothing was made: what comes to lie there is another's
                else:
                    note_done(pair.written, marks[pair.written])
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
    from bunraku.files import FORMATS

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
    from bunraku.core.body.layout import JOINT_NAMES

    for name in names:
        if name not in JOINT_NAMES:
            raise FormatError(path, f"'{name[:40]}' is none of SMPL's joints: {', '.join(JOINT_NAMES)}")
    return tuple(sorted(names.items()))
