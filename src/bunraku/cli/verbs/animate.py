"""`bunraku animate`: a character and a sentence give an animation."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from bunraku.cli.options.directing import PathOption, PinOption, parse_path, parse_pin
from bunraku.cli.options.generating import GeneratingOptions
from bunraku.cli.options.orientation import stand_up
from bunraku.cli.output.checks import check_folder, check_input, check_mask, check_range, check_sequence, slug
from bunraku.cli.output.ledger import fingerprint
from bunraku.cli.output.outputs import check_outputs, fitting_stages, save_all
from bunraku.cli.output.progress import Report, stages
from bunraku.cli.verbs.batch import Clip, characters_of, clips_of, clips_to_do, make_clips, read_lines
from bunraku.errors import BunrakuError, OptionError
from bunraku.nn.spread import parse_jobs
from bunraku.pipelines.together import check_apparel_option, check_together

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter
    from bunraku.core.character import Character, Handles
    from bunraku.core.motion import HandleMotion

__all__ = ["Animate"]


@dataclass(frozen=True)
class Animate(GeneratingOptions):
    """Make a character do what a sentence says.

    The character is a .glb, .gltf, .vrm, .pmx, .pmd, .fbx, .obj, .ply or .stl file; it needs no rig. The animation is
    written as a GLB that keeps the mesh, materials and textures of the input, as an NPZ of the handle motion, or as a
    sequence of meshes.

    Several prompts in a row, parted by semicolons, blend into each other: "walks:4; jumps:2; waves:3". The numbers are
    seconds.

    Example: bunraku animate dragon.glb "walks forward, then waves with the left hand" --seconds 6 -o wave.glb --preview
    wave.mp4
    """

    character: tyro.conf.Positional[Path]
    """The mesh to animate; or a folder of them, each of which gets a folder of clips in the one that -o names."""
    prompt: tyro.conf.Positional[str] = ""
    """What it does, in English (or German, French, Spanish, Japanese or Chinese, read through a table of words); or
    several prompts in a row with their seconds.
    """
    prompts: Path | None = None
    """A text file with one prompt a line, in place of PROMPT: each line gives a GLB in the folder that -o names. What
    was made of the same before is left as it is, so a run that was stopped goes on.
    """
    jobs: Annotated[str, tyro.conf.arg(metavar="{N,ray}")] = "1"
    """How many processes share the clips of --prompts or of a folder, or "ray" for a Ray cluster."""
    seconds: float = 6.0
    """Length of the clip, 0.5 to 120; prompts in a row without seconds of their own share it."""
    loop: bool = False
    """Make a loop: the clip ends in the pose that it starts in, at the same speed."""
    apparel: Annotated[str, tyro.conf.arg(metavar="{auto,none,simulate,learn,MASK}")] = "none"
    """How hair and clothes move: "none" with the body, "simulate" by the physics of an MMD or VRM file, on the bones of
    its own rig, "learn" by a network that finds them on any mesh, "auto" by the one or the other; or the file of a mask
    (.npy, .txt, painted .ply or .glb) of what is to be learned.
    """
    stiffness: float = 1.0
    """How stiff learned apparel is, as a factor, 0.001 to 1000."""
    candidates: int = 3
    """Motions that are drawn, of which the one is written that a ranker likes best, 1 to 16; 1 is the fastest."""
    takes: int = 1
    """Write several takes of one prompt, 1 to 100: NAME-1.glb, NAME-2.glb and so on, with seeds that follow --seed."""
    in_place: bool = False
    """Take the way over the ground out: the character walks on the spot."""
    after: Path | None = None
    """A .glb or .npz clip of Bunraku: start in its last pose."""
    path: PathOption = ""
    """Points on the ground that the root passes, x and z in metres from where the clip starts to where it ends, such as
    "0,0 1,2 3,2"; with "@SECONDS" behind each where times matter.
    """
    pin: PinOption = ()
    """Where the wrist of a hand or the ankle of a foot is at a time, such as left_hand@2.0=0.3,1.4,0.2: left_hand,
    right_hand, left_foot or right_foot, seconds (+ seconds for which it is held), x, y and z in metres. May be given
    more than once.
    """

    def run(self) -> int:
        prompts = self._prompts()
        self.check()
        batch = self._batch()
        if not batch:
            check_input(self.character)
        if self.after is not None:
            check_input(self.after)
        check_apparel_option(self.apparel, self.stiffness, dashes="--")
        check_mask(self.apparel)
        check_together(
            self.apparel, loop=self.loop, after=self.after is not None, handles=self.handles != "predict",
            path=bool(self.path), in_place=self.in_place, pins=bool(self.pin), dashes="--",
        )  # fmt: skip
        parse_path(self.path)
        [parse_pin(pin) for pin in self.pin]
        fitting_stages(self.without, shape=True)
        check_range("--candidates", self.candidates, 1, 16)
        check_range("--takes", self.takes, 1, 100)
        jobs = parse_jobs(self.jobs)
        if batch:
            return self._many(prompts, jobs)
        if jobs != 1:
            raise OptionError("--jobs shares the clips of --prompts, or of a folder of characters; leave it out")
        named = self.output or (Path(f"{self.character.stem}-{slug(self.prompt)}.glb"),)
        takes = [_numbered(named, self.preview, take, self.takes) for take in range(self.takes)]
        inputs = [self.character] + ([self.after] if self.after else [])
        for outputs, previews in takes:
            check_outputs(outputs, previews, inputs, overwrite=self.overwrite)
        with stages() as report:
            character, how = _ready(self, self.character, report)
            _say_limits(self.character, character, how["handles"], prompts)

            from bunraku.pipelines.animate import animate_each

            for take, (outputs, previews) in enumerate(takes):
                drawn = {**self.sampling, "seed": self.seed + take}
                (animation,) = animate_each(character, prompts, **how, **drawn, progress=report)
                save_all(animation, outputs, previews, self.fps, report)
        return 0

    def _batch(self) -> bool:
        """Whether this makes clips in a folder."""
        return self.prompts is not None or self.character.is_dir()

    def _many(self, prompts: list[str], jobs: int | str) -> int:
        from bunraku.pipelines.animate import AT_ONCE

        if self.character.is_dir():
            characters = characters_of(self.character)
        else:
            check_input(self.character)
            characters = {self.character: ""}
        folder = self.output[0] if self.output else Path(f"{self.character.stem}-clips")
        if folder.is_dir() and self.character.is_dir() and folder.samefile(self.character):
            raise OptionError(f"the clips would lie among the characters of {folder}; name another folder with -o")
        clips: list[Clip] = []
        todo: list[Clip] = []
        if self.character.is_dir() and not folder.is_file():
            check_folder(folder)
            folder.mkdir(exist_ok=True)  # in which each gets its own
        for character, name in characters.items():
            own = clips_of(folder / name, character, prompts, AT_ONCE, self._mark)
            todo += clips_to_do(own, self.overwrite)
            clips += own
        if len(todo) < len(clips):
            print(f"{len(clips) - len(todo)} of {len(clips)} clips are there already")
        if not todo:
            return 0
        with stages() as report:
            if len(characters) == 1 and jobs == 1:  # what is wrong with it is said at once, and in its place
                _kept(self, next(iter(characters)))
            here = self
            if jobs == "ray" and Path(self.apparel).is_file():
                here = replace(self, apparel=str(Path(self.apparel).resolve()))
            failed = make_clips(todo, partial(_clips, here), jobs, report)
        return 1 if failed else 0

    def _mark(self, character: Path, prompt: str) -> str:
        """What a clip is made of."""
        same = ("output", "preview", "overwrite", "character", "prompt", "prompts", "after", "jobs")
        options = {field.name: getattr(self, field.name) for field in fields(self) if field.name not in same}
        return fingerprint([character], "animate", prompt, options)

    def _prompts(self) -> list[str]:
        """All prompts, checked."""
        if self.prompts is not None and self.prompt:
            raise OptionError("a prompt and --prompts are both given; leave one out")
        if self._batch() and (self.preview or self.after or len(self.output) > 1 or self.takes > 1):
            what = "--prompts" if self.prompts is not None else "a folder of characters"
            raise OptionError(f"{what} makes GLB files in one folder (-o), without --preview, --after and --takes")
        if self.prompts is None:
            check_sequence(self.prompt, self.seconds, self.anyway)
            return [self.prompt]
        return read_lines(self.prompts, self.seconds, self.anyway)


def _clips(verb: Animate, clips: list[Clip]) -> Iterator[str]:
    """Make the clips of a pass; tell of each what went wrong, "" for nothing."""
    from bunraku.pipelines.animate import animate_each

    path, prompts = clips[0].character, clips[0].beside
    done = 0
    try:
        character, how = _kept(verb, path)
        _say_limits(path, character, how["handles"], [prompts[clip.place] for clip in clips])
        only = {clip.place for clip in clips}
        animations = animate_each(character, prompts, **how, **verb.sampling, only=only)
        for clip in clips:
            next(animations).save(clip.path, fps=verb.fps)
            done += 1
            yield ""
        return
    except BunrakuError as error:
        reason = str(error)
    except MemoryError:
        reason = "the memory is not enough for this; simplify the mesh or shorten the clip"
    except Exception as error:  # one bad file must not stop the others
        reason = f"this is a fault of Bunraku, not yours: {type(error).__name__}: {error}"
    if reason.startswith(f"{path}: "):  # so all of its clips fail
        yield from [reason] * (len(clips) - done)
        return
    yield reason
    if clips[done + 1 :]:
        yield from _clips(verb, clips[done + 1 :])


@lru_cache(maxsize=1)
def _kept(verb: Animate, path: Path) -> tuple[Character, dict[str, Any]]:
    """What `_ready` gives, for clips of one character that follow another."""
    return _ready(verb, path, lambda stage, done: None)


def _ready(verb: Animate, path: Path, report: Report) -> tuple[Character, dict[str, Any]]:
    """A character as it is to be animated, and how, but for what is drawn."""
    from bunraku.io import load_character

    report("load", 0.0)
    character = stand_up(load_character(path, unit="m"), path, verb.up, verb.front, verb.unit)
    report("load", 1.0)

    from bunraku.pipelines.animate import apparel_way, rig

    bones = apparel_way(character, verb.apparel, verb.handles) != "handles"
    handles = verb.handles if bones else rig(character, handles=verb.handles, progress=report)
    after = None if verb.after is None or isinstance(handles, str) else _before(verb.after, character, handles)
    return character, {
        "seconds": verb.seconds, "handles": handles, "apparel": verb.apparel, "stiffness": verb.stiffness,
        "loop": verb.loop, "in_place": verb.in_place, "after": after, "path": parse_path(verb.path),
        "pins": [parse_pin(pin) for pin in verb.pin], "stages": fitting_stages(verb.without, shape=True),
        "candidates": verb.candidates,
    }  # fmt: skip


def _say_limits(path: Path, character: Character, handles: Handles | str, prompts: list[str]) -> None:
    """Say on standard error what the prompts ask for that this body cannot do."""
    if isinstance(handles, str):  # its own rig moves it
        return
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.language.parse import parse
    from bunraku.pipelines.decisions import suited

    plan = Anatomy.of(character, handles).plan
    for note in dict.fromkeys(note for prompt in prompts for note in suited(parse(prompt, 120, True), plan).cannot):
        print(f"{path}: {note}", file=sys.stderr)


def _numbered(
    outputs: tuple[Path, ...], previews: tuple[Path, ...], take: int, takes: int
) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """The files of one take: as they are named where there is one, else with its number."""
    if takes == 1:
        return outputs, previews

    def names(paths: tuple[Path, ...]) -> tuple[Path, ...]:
        return tuple(path.with_name(f"{path.stem}-{take + 1}{path.suffix}") for path in paths)

    return names(outputs), names(previews)


def _before(path: Path, character: Character, handles: Handles) -> HandleMotion | AnimatedCharacter:
    """The clip to start from: of this character if it was made for it, of the reference body otherwise."""
    from bunraku.io.clips import load_clip

    clip = load_clip(path)
    return clip.on(character, handles) or clip.of_the_reference_body()
