"""`bunraku animate`: a character and a sentence give an animation."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.cli.options.directing import DirectingOptions
from bunraku.cli.options.generating import GeneratingOptions
from bunraku.cli.options.orientation import stand_up
from bunraku.cli.options.sampling import ApparelOptions
from bunraku.cli.output.alone import alone
from bunraku.cli.output.checks import check_folder, check_input, check_mask, check_sequence, slug, written_path
from bunraku.cli.output.ledger import fingerprint
from bunraku.cli.output.outputs import check_outputs, fitting_stages, save_all
from bunraku.cli.output.progress import Report, stages
from bunraku.cli.verbs.batch import Clip, characters_of, clips_of, clips_to_do, make_clips, read_lines
from bunraku.core.request.limits import TAKES
from bunraku.errors import BunrakuError, OptionError
from bunraku.nn.spread import parse_jobs
from bunraku.pipelines.requests.request import Request

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter
    from bunraku.core.character import Character, Handles
    from bunraku.core.motion import HandleMotion
    from bunraku.language.sentence import Sentence
    from bunraku.pipelines.animator import Body

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
    apparel: tyro.conf.OmitArgPrefixes[ApparelOptions] = field(default_factory=ApparelOptions)
    """How hair and clothes move."""
    directing: tyro.conf.OmitArgPrefixes[DirectingOptions] = field(default_factory=DirectingOptions)
    """What the motion must meet."""
    takes: int = 1
    """Write several takes of one prompt, 1 to 100: NAME-1.glb, NAME-2.glb and so on, with seeds that follow --seed."""

    def run(self) -> int:
        prompts = self._prompts()
        self.check()
        batch = self._batch()
        if not batch:
            check_input(self.character)
        after = self.directing.after
        if after is not None:
            check_input(after)
        self.apparel.check("--")
        check_mask(self.apparel)
        self.request().check("--")
        TAKES.check(self.takes, "--takes")
        jobs = parse_jobs(self.jobs)
        if batch:
            return self._many([sentence.prompt for sentence in prompts], jobs)
        if jobs != 1:
            raise OptionError("--jobs shares the clips of --prompts, or of a folder of characters; leave it out")
        named = self.output or (Path(f"{self.character.stem}-{slug(self.prompt)}.glb"),)
        takes = [_numbered(named, self.preview, take, self.takes) for take in range(self.takes)]
        inputs = [self.character] + ([after] if after else [])
        with alone(written_path(path) for outputs, previews in takes for path in (*outputs, *previews)):
            for outputs, previews in takes:
                check_outputs(outputs, previews, inputs, overwrite=self.overwrite)
            self._make(prompts[0], takes)
        return 0

    def _make(self, sentence: Sentence, takes: list[tuple[tuple[Path, ...], tuple[Path, ...]]]) -> None:
        """Make and write each take: its files and its previews."""
        with stages() as report:
            body, request = _ready(self, self.character, report)
            request = replace(request, sentence=sentence)
            _say_limits(self.character, body, [sentence])

            from bunraku.pipelines.animator import Animator

            animator = Animator.shipped(report)
            for take, (outputs, previews) in enumerate(takes):
                animation = animator(body, request.with_seed(self.sampling.seed + take))
                save_all(animation, outputs, previews, self.fps, report)

    def request(self) -> Request:
        """What is asked for; the clip that is followed is only named."""
        return Request(
            self.prompt, self.sampling, self.directing.constraints(), self.apparel,
            fitting_stages(self.without, shape=True), self.handles, self.anyway,
        )  # fmt: skip

    def _batch(self) -> bool:
        """Whether this makes clips in a folder."""
        return self.prompts is not None or self.character.is_dir()

    def _many(self, prompts: list[str], jobs: int | str) -> int:
        if self.character.is_dir():
            characters = characters_of(self.character)
        else:
            check_input(self.character)
            characters = {self.character: ""}
        folder = self.output[0] if self.output else Path(f"{self.character.stem}-clips")
        if folder.is_dir() and self.character.is_dir() and folder.samefile(self.character):
            raise OptionError(f"the clips would lie among the characters of {folder}; name another folder with -o")
        with alone(folders=[folder]):
            return self._fill(folder, characters, prompts, jobs)

    def _fill(self, folder: Path, characters: dict[Path, str], prompts: list[str], jobs: int | str) -> int:
        """Make the clips of a folder that are not there yet."""
        from bunraku.pipelines.animator import AT_ONCE

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
            if jobs == "ray" and self.apparel.mask is not None:
                here = replace(self, apparel=replace(self.apparel, motion=str(self.apparel.mask.resolve())))
            failed = make_clips(todo, partial(_clips, here), jobs, report)
        return 1 if failed else 0

    def _mark(self, character: Path, prompt: str) -> str:
        """What a clip is made of."""
        same = ("output", "preview", "overwrite", "character", "prompt", "prompts", "jobs")
        options = {name: value for name, value in asdict(self).items() if name not in same}
        return fingerprint([character], "animate", prompt, options)

    def _prompts(self) -> list[Sentence]:
        """All prompts, parsed."""
        if self.prompts is not None and self.prompt:
            raise OptionError("a prompt and --prompts are both given; leave one out")
        if self._batch() and (self.preview or self.directing.after or len(self.output) > 1 or self.takes > 1):
            what = "--prompts" if self.prompts is not None else "a folder of characters"
            raise OptionError(f"{what} makes GLB files in one folder (-o), without --preview, --after and --takes")
        if self.prompts is None:
            return [check_sequence(self.prompt, self.sampling.seconds, self.anyway)]
        return read_lines(self.prompts, self.sampling.seconds, self.anyway)


def _clips(verb: Animate, clips: list[Clip]) -> Iterator[str]:
    """Make the clips of a pass; tell of each what went wrong, "" for nothing."""
    from bunraku.language.parse import parse
    from bunraku.pipelines.animator import Animator

    path, prompts = clips[0].character, clips[0].beside
    done = 0
    try:
        body, request = _kept(verb, path)
        sentences = [parse(prompt, verb.sampling.seconds, verb.anyway) for prompt in prompts]
        _say_limits(path, body, [sentences[clip.place] for clip in clips])
        requests = [replace(request, sentence=sentence) for sentence in sentences]
        animations = Animator.shipped().each(body, requests, {clip.place for clip in clips})
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
def _kept(verb: Animate, path: Path) -> tuple[Body, Request]:
    """What `_ready` gives, for clips of one character that follow another."""
    return _ready(verb, path, lambda stage, done: None)


def _ready(verb: Animate, path: Path, report: Report) -> tuple[Body, Request]:
    """A character as it is to be animated, and what is asked of it."""
    from bunraku.io import load_character

    report("load", 0.0)
    character = stand_up(load_character(path, unit="m"), path, verb.up, verb.front, verb.unit)
    report("load", 1.0)

    from bunraku.pipelines.animator import Animator

    request = verb.request()
    body = Animator.shipped(report).body(character, request)
    if verb.directing.after is not None and body.anatomy is not None:
        before = _before(verb.directing.after, character, body.anatomy.handles)
        request = replace(request, constraints=request.constraints.following(before))
    return body, request


def _say_limits(path: Path, body: Body, sentences: list[Sentence]) -> None:
    """Say on standard error what sentences ask for that this body cannot do."""
    if body.anatomy is None:  # its own rig moves it
        return
    from bunraku.pipelines.decisions import suited

    plan = body.anatomy.plan
    for note in dict.fromkeys(note for sentence in sentences for note in suited(sentence, plan).cannot):
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
