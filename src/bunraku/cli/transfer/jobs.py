"""The work of `bunraku transfer`: which file is what, what a pair of them gives, and what is done already."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from bunraku.cli.output.checks import written_path
from bunraku.cli.output.ledger import fingerprint
from bunraku.errors import BunrakuError, FormatError
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.transfer import TransferRequest

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter
    from bunraku.core.character import Character, Handles
    from bunraku.pipelines.transfer import Source
    from bunraku.retarget.fit import Stages

__all__ = ["Pair", "Settings", "animation_of", "holds_character", "marks_of", "pairs_of", "transfer_pair"]


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
    from bunraku.formats.files import check_input, open_input
    from bunraku.io.registry import detect

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
        from bunraku.formats.gltf.container.open import open_document

        return bool(open_document(path, data).items("meshes"))
    from bunraku.formats.fbx.read import fbx_facts

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
    from bunraku.io.registry import check_writes
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
    from bunraku.cli.options.orientation import stand_up
    from bunraku.core.mmd_model import mmd_model
    from bunraku.io import load_character
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
