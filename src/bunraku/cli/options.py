"""Options that several commands share: orientation, sampling, apparel, skeletons and constraints."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bunraku.cli import shared
from bunraku.core.parallel import MOST_JOBS
from bunraku.core.request import FPS
from bunraku.errors import OptionError
from bunraku.pipelines.requests import Apparel, Constraints, Sampling

if TYPE_CHECKING:
    from bunraku.anatomy.handles.orientation import ResolvedAxes
    from bunraku.core.character import Character
    from bunraku.core.travel import GroundPath
    from bunraku.retarget.pins import Pin

SkeletonOption = Annotated[
    Literal["mixamo", "vrm", "unreal"] | None,
    tyro.conf.arg(
        help_behavior_hint="",
        help="For people: a skeleton in place of the handles, in a T-pose and with the names of Mixamo, VRM or "
        "Unreal, as the humanoid retargeting of engines needs it.",
    ),
]
ProgramOption = Annotated[
    Literal["unity", "unreal", "godot", "blender", "three", "vrchat"] | None,
    tyro.conf.arg(name="for", help_behavior_hint=""),
]


AxisOption = Annotated[str, tyro.conf.arg(metavar="{auto,+x,-x,+y,-y,+z,-z}")]
UnitOption = Literal["auto", "m", "cm", "mm", "in"]
OPTIONS = ("--up", "--front")


def check_axes(up: str, front: str) -> None:
    """Raise OptionError unless these are axes at a right angle, or "auto"."""
    from bunraku.core.geometry.axes import axis_name

    names = {}
    for option, value in zip(OPTIONS, (up, front), strict=True):
        if value.strip().lower() != "auto":
            try:
                names[option] = axis_name(value)
            except OptionError as error:
                raise OptionError(f"{option}: {error}, or auto") from None
    if len(names) == 2 and names["--up"][1] == names["--front"][1]:
        raise OptionError(
            f"--up {names['--up']} and --front {names['--front']} lie along the same axis; choose two at a right angle"
        )


def stand_up(character: Character, path: Path, up: str = "auto", front: str = "auto", unit: str = "auto") -> Character:
    """The character of a file in metres, standing along +Y and facing +Z, by the values of the options; lines on
    standard error say what was guessed. OptionError where the unit of the file cannot be changed.
    """
    from bunraku.files import in_metres, rotated

    resolved, line = resolve_file(character, up, front)
    if line:
        print(f"{path}: {line}", file=sys.stderr)
    character = rotated(character, resolved.up, resolved.front)
    character, note = in_metres(character, unit, "+y")
    if note:
        print(f"{path}: {note}. Type --unit m to keep its numbers.", file=sys.stderr)
    return character


@dataclass(frozen=True)
class StandingOptions:
    """How a character's file is read."""

    up: AxisOption = "auto"
    """The axis that is up in the character's file. "auto" goes by the rule of the format, and by the shape where it has
    none.
    """
    front: AxisOption = "auto"
    """The axis that the character faces in its file."""
    unit: UnitOption = "auto"
    """The unit of lengths in the character's file. "auto" goes by the rule of the format, and by the height where it
    has none.
    """
    character: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Which character moves where a file has several: 1 is the largest."""

    def check(self) -> None:
        """Raise OptionError unless up and front are axes at a right angle, or "auto"."""
        check_axes(self.up, self.front)

    def load(self, path: Path, clips: float | None = None) -> Character:
        """The character of a file, upright and in metres, with its clips where a rate [1/s] is given."""
        from bunraku.files import load_character

        return self.stood(load_character(path, unit="m", clips=clips), path)

    def stood(self, given: Character, path: Path) -> Character:
        """A character as its file has it, upright and in metres, or the one that is chosen of several."""
        from bunraku.anatomy.scene import separated

        character, lines = separated(stand_up(given, path, self.up, self.front, self.unit), self.character)
        for line in lines:
            print(f"{path}: {line}", file=sys.stderr)
        return character


@dataclass(frozen=True)
class WhichOptions(StandingOptions):
    """`StandingOptions` of commands whose --character is a file."""

    character: Annotated[int | None, tyro.conf.arg(name="which", metavar="N")] = None
    """Which character moves where a file has several: 1 is the largest."""


def resolve_file(character: Character, up: str = "auto", front: str = "auto") -> tuple[ResolvedAxes, str]:
    """How a character of a file is taken to stand, and what there is to say about it."""
    from bunraku.anatomy.handles.orientation import resolve_axes

    resolved = resolve_axes(character, up, front)
    return resolved, said_axes(resolved, up, front)


def stands_line(character: Character, up: str = "auto", front: str = "auto") -> str:
    """How a character is taken to stand as its file has it, and how sure that is, in one line."""
    resolved, note = resolve_file(character, up, front)
    taken = f"stands with {resolved.up.upper()} up, facing {resolved.front.upper()}"
    if resolved.guess is None:
        return f"{taken}, as it is said"
    return f"{taken} ({_percent(resolved.sure)} sure)" + (f" - {note}" if note else "")


def said_axes(resolved: ResolvedAxes, up: str = "auto", front: str = "auto") -> str:
    """A sentence about a guess: what was taken, how sure that is, and what to type to set it. Empty where nothing was
    guessed, or the guess is at least 85 % sure.
    """
    from bunraku.anatomy.handles.orientation import SURE

    guess, other = resolved.guess, resolved.other
    if guess is None or other is None or resolved.sure >= SURE:
        return ""
    given = [value.strip().lower() != "auto" for value in (up, front)]
    taken, chance = (resolved.up, resolved.front), guess.probability(*other)
    return (
        f"taken as {_listed(taken, given)} ({_percent(resolved.sure)} sure), perhaps {_listed(other, given)} "
        f"({_percent(chance)}). To set it, type {_typed(taken, given)}, or else "
        f"{_typed(other, given)}; `bunraku inspect FILE --views views.png` shows which."
    )


def _percent(chance: float) -> str:
    return f"{100 * min(chance, 0.99):.0f} %"


def _listed(axes: tuple[str, str], given: list[bool]) -> str:
    words = (f"{axes[0].upper()} up", f"facing {axes[1].upper()}")
    return ", ".join(word for word, named in zip(words, given, strict=True) if not named)


def _typed(axes: tuple[str, str], given: list[bool]) -> str:
    """The options that say these axes, those that are not given."""
    return " ".join(f"{option} {axis}" for option, axis, named in zip(OPTIONS, axes, given, strict=True) if not named)


@dataclass(frozen=True)
class SamplingOptions(Sampling):
    """`Sampling` on the command line."""

    seconds: Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")] = None
    """Length of the clip, at least 0.5, which prompts in a row without seconds of their own share. Default: what fits
    the action; 6 where it goes on, as walking does, or with a path or a pin.
    """
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Sampling steps, 1 to 1000; more is slower. Default: 4, distilled; 8 with --guidance."""
    guidance: Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")] = None
    """How closely to follow the sentence, 0 to 20. Default: 3.5."""


@dataclass(frozen=True)
class EditSamplingOptions(SamplingOptions):
    """`Sampling` of a clip that is edited: it has its length, and one motion is drawn."""

    seconds: tyro.conf.Suppress[float | None] = None
    candidates: tyro.conf.Suppress[int] = 3


FEELS = {"stiff": 4.0, "natural": 1.0, "loose": 0.3}
"""Factors on the stiffness of apparel. Limits narrow by their root, to half or 1.8 times: set on twelve MMD and
VRM files, in which links of hair turn 22 degrees in the median, and 10 to 35 from the stiffest to the loosest.
"""


def _feel(words: list[str]) -> float:
    try:
        return FEELS.get(words[0]) or float(words[0])
    except ValueError:
        raise ValueError(f"it is {', '.join(FEELS)} or a factor, not '{words[0]}'") from None


FeelOption = Annotated[
    float,
    tyro.conf.arg(
        name="apparel-feel",
        help="How hair and clothes swing: stiff, natural or loose, or a factor on their stiffness, 0.001 to 1000.",
    ),
    tyro.constructors.PrimitiveConstructorSpec(
        nargs=1, metavar="{stiff,natural,loose,FACTOR}", instance_from_str=_feel,
        is_instance=lambda value: isinstance(value, float | int), str_from_instance=lambda value: [f"{value:g}"],
    ),
]  # fmt: skip


@dataclass(frozen=True)
class ApparelOptions(Apparel):
    """`Apparel` on the command line."""

    motion: Annotated[str, tyro.conf.arg(name="apparel", metavar="{auto,none,simulate,chains,learn,MASK}")] = "none"
    """How hair and clothes move: "none" with the body, "simulate" by the physics of an MMD or VRM file, or else by
    the bones of hair and clothes of a person's rig, "chains" by chains of bones that are laid over what a network finds
    on any mesh, "learn" by a network alone, "auto" by the first of physics, bones and chains that there is; or the file
    of a mask (.npy, .txt, painted .ply or .glb) of what the network moves.
    """
    stiffness: FeelOption = 1.0


@dataclass(frozen=True, kw_only=True)
class GeneratingOptions:
    """How a motion is drawn from a sentence, fitted to a character and written."""

    output: shared.OutputOption = ()
    """File to write: .glb, .usd, .usdc, .usdz, .fbx, .npz (the handle motion), .bvh or .vrma (what the
    humanoid skeleton does), .vmd (of MMD characters), .obj or .ply (a folder with one mesh a frame), .mp4, .webp, .gif
    or .png. May be given more than once.
    Default: a name made of the input's and the sentence, in this folder.
    """
    preview: shared.PreviewOption = ()
    sampling: tyro.conf.OmitArgPrefixes[SamplingOptions] = field(default_factory=SamplingOptions)
    """How the motion is drawn."""
    fps: shared.FpsOption = shared.USUAL_FPS
    handles: shared.HandlesOption = "predict"
    overwrite: shared.OverwriteOption = False
    without: shared.WithoutOption = ()
    force: bool = False
    """Go on where no movement of the sentence is understood; the network then makes some motion."""
    standing: tyro.conf.OmitArgPrefixes[StandingOptions] = field(default_factory=StandingOptions)
    """How the character's file is read."""

    def check(self) -> None:
        """Raise OptionError unless a motion can be made with these."""
        self.sampling.check("--")
        FPS.check(self.fps, "--fps")
        self.standing.check()


PinOption = Annotated[
    tuple[str, ...],
    tyro.conf.arg(
        metavar="PART@TIME=X,Y,Z",
        help="Where the wrist of a hand or the ankle of a foot is at a time, such as left_hand@2.0=0.3,1.4,0.2: "
        "left_hand, right_hand, left_foot or right_foot, seconds (+ seconds for which it is held), x, y and z in "
        "metres. May be given more than once.",
    ),
    tyro.conf.UseAppendAction,
]
PathOption = Annotated[str, tyro.conf.arg(metavar="'X,Z X,Z ...'")]
_PIN = re.compile(r"(?P<part>[a-z_-]+)@(?P<time>[^=+]+)(\+(?P<hold>[^=]+))?=(?P<place>.+)")


@dataclass(frozen=True)
class DirectingOptions:
    """Constraints of a motion on the command line."""

    loop: bool = False
    """Make a loop: the clip ends in the pose that it starts in, at the same speed."""
    in_place: bool = False
    """Remove the travel over the ground: the character walks on the spot."""
    after: Path | None = None
    """A .glb or .npz clip of Bunraku: start in its last pose."""
    path: PathOption = ""
    """Points on the ground that the root passes, x and z in metres from where the clip starts to where it ends, such as
    "0,0 1,2 3,2"; with "@SECONDS" behind each where times matter.
    """
    pin: PinOption = ()

    def constraints(self) -> Constraints:
        """The constraints, with the file of a clip to follow; OptionError where a text is not a path or a pin."""
        return Constraints.of(
            loop=self.loop, in_place=self.in_place, after=None if self.after is None else str(self.after),
            path=parse_path(self.path), pins=[parse_pin(pin) for pin in self.pin],
        )  # fmt: skip


def _numbers(text: str, count: int) -> tuple[float, ...]:
    values = tuple(float(value) for value in text.split(","))
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise ValueError
    return values


def parse_pin(text: str) -> Pin:
    """The pin of "left_hand@2.0=0.3,1.4,0.2", or "left_hand@2.0+0.5=0.3,1.4,0.2", which is held for half a second;
    OptionError for other texts.
    """
    from bunraku.retarget.pins import PINNED, Pin

    match = _PIN.fullmatch(text.strip())
    try:
        if match is None:
            raise ValueError
        x, y, z = _numbers(match["place"], 3)
        return Pin(match["part"].replace("-", "_"), float(match["time"]), (x, y, z), None, float(match["hold"] or 0))
    except ValueError:
        raise OptionError(
            f"--pin is a part, a time and a position in metres, such as left_hand@2.0=0.3,1.4,0.2 (parts: "
            f"{', '.join(PINNED)}), not '{text}'"
        ) from None


def parse_jobs(text: str) -> int | str:
    """The value of the option for parallel work: a number, or "ray"; OptionError for other texts."""
    if text == "ray":
        return text
    if not text.isdecimal() or len(text) > 4 or not 1 <= int(text) <= MOST_JOBS:
        raise OptionError(f"--jobs is a number from 1 to {MOST_JOBS}, or ray, not {text[:40]!r}")
    return int(text)


def parse_path(text: str) -> GroundPath | None:
    """The path of "0,0 1,2 3,2", or "0,0@0 1,2@2.5" with the seconds at which each point is passed; None for "",
    OptionError for other texts.
    """
    from bunraku.core.travel import GroundPath

    if not text.strip():
        return None
    points: list[tuple[float, float]] = []
    times: list[float] = []
    try:
        for word in text.split():
            coordinates, at, time = word.partition("@")
            x, z = _numbers(coordinates, 2)
            points.append((x, z))
            if at:
                times.append(float(time))
        if times and len(times) != len(points):
            raise ValueError
    except ValueError:
        raise OptionError(
            f"--path is points on the ground with x and z in metres, such as '0,0 1,2 3,2', all or none with their "
            f"seconds (1,2@2.5), not '{text}'"
        ) from None
    return GroundPath(tuple(points), tuple(times) if times else None)
