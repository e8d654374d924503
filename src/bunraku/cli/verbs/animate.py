"""`bunraku animate`: a character and a sentence give an animation."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bunraku.cli.options.directing import DirectingOptions
from bunraku.cli.options.generating import GeneratingOptions
from bunraku.cli.options.orientation import stand_up
from bunraku.cli.options.sampling import ApparelOptions
from bunraku.cli.options.skeleton import ProgramOption, SkeletonOption
from bunraku.cli.output.alone import alone
from bunraku.cli.output.checks import (
    check_folder,
    check_input,
    check_mask,
    check_output,
    check_sequence,
    check_written,
    slug,
    written_path,
)
from bunraku.cli.output.ledger import fingerprint, note_written
from bunraku.cli.output.outputs import check_outputs, fitting_stages, save_all, save_clips_to, wrote
from bunraku.cli.output.progress import Report, stages
from bunraku.cli.verbs.batch import Clip, characters_of, clips_of, clips_to_do, make_clips, read_lines
from bunraku.core.request.limits import SECONDS, TAKES
from bunraku.errors import BunrakuError, OptionError
from bunraku.nn.spread import parse_jobs
from bunraku.pipelines.requests.request import Request

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter
    from bunraku.core.character import Character, Handles
    from bunraku.core.motion import HandleMotion
    from bunraku.io.presets import Preset
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

    Several prompts of their own make as many clips in one file, as game engines take them, loops where what is done
    goes on as it is: bunraku animate knight.glb "idle" "walks forward" "runs" "Attack=attacks" -o knight-moves.glb

    For an engine: bunraku animate knight.glb "idle" "walks forward" --for unity

    Example: bunraku animate dragon.glb "walks forward, then waves with the left hand" --seconds 6 -o wave.glb --preview
    wave.mp4
    """

    character: tyro.conf.Positional[Path]
    """The mesh to animate; or a folder of them, each of which gets a folder of clips in the one that -o names."""
    prompt: tyro.conf.Positional[tuple[str, ...]] = ()
    """What it does, in English (or German, French, Spanish, Japanese or Chinese, read through a table of words); or
    several prompts in a row with their seconds. More than one makes as many clips in one GLB, each named by its words
    or by what stands before an equals sign: "Walk=walks forward".
    """
    prompts: Path | None = None
    """A text file with one prompt a line, in place of PROMPT: each line gives a GLB in the folder that -o names. What
    was made of the same before is left as it is, so a run that was stopped goes on.
    """
    one_file: bool = False
    """Write the clips of --prompts into the one GLB that -o names."""
    add: bool = False
    """Keep what the GLB that -o names holds, and add to its clips; it may be CHARACTER itself."""
    jobs: Annotated[str, tyro.conf.arg(metavar="{N,ray}")] = "1"
    """How many processes share the clips of --prompts or of a folder, or "ray" for a Ray cluster."""
    apparel: tyro.conf.OmitArgPrefixes[ApparelOptions] = field(default_factory=ApparelOptions)
    """How hair and clothes move."""
    rig: Literal["auto", "own", "handles"] = "auto"
    """What is moved: the bones of the file's "own" skeleton, which keeps its names, weights and other clips; the 30
    "handles"; or by "auto" the bones where they are understood as those of a person, of four legs or of a bird, and
    handles otherwise.
    """
    skeleton: SkeletonOption = None
    """Move a tree of joints in a T-pose with the names of Mixamo, VRM or Unreal, made of the handles, which engines'
    humanoid retargeting takes. For persons.
    """
    program: ProgramOption = None
    """Write the file that a program wants: its format, axes and unit, frame rate, names of joints for persons without a
    skeleton of their own, and where the travel is (docs/engines.md). A prompt that tells of a cycle makes a loop.
    """
    directing: tyro.conf.OmitArgPrefixes[DirectingOptions] = field(default_factory=DirectingOptions)
    """What the motion must meet."""
    takes: int = 1
    """Write several takes of one prompt, 1 to 100: NAME-1.glb, NAME-2.glb and so on, with seeds that follow --seed."""

    def run(self) -> int:
        prompts = self._prompts()
        self.check()
        batch = self._batch()
        several = self.one_file or self.add or len(self.prompt) > 1 or self.program is not None
        if self.program is not None and (batch or self.add):
            raise OptionError("--for writes the clips of one character at once; leave out --add, or say --one-file")
        if not batch:
            check_input(self.character)
        after = self.directing.after
        if after is not None:
            check_input(after)
        self.apparel.check("--")
        check_mask(self.apparel)
        self._request().check("--")
        if self.skeleton is not None and self.rig != "auto":
            raise OptionError("--skeleton says what is moved; leave out --rig")
        TAKES.check(self.takes, "--takes")
        jobs = parse_jobs(self.jobs)
        if batch:
            return self._many([sentence.prompt for sentence in prompts], jobs)
        if jobs != 1:
            raise OptionError("--jobs shares the clips of --prompts, or of a folder of characters; leave it out")
        if several:
            return self._one_file(prompts)
        if prompts[0].seconds > SECONDS.high:
            return self._long(prompts[0])
        named = self.output or (Path(f"{self.character.stem}-{slug(self.prompt[0])}.glb"),)
        takes = [_numbered(named, self.preview, take, self.takes) for take in range(self.takes)]
        inputs = [self.character] + ([after] if after else [])
        with alone(written_path(path) for outputs, previews in takes for path in (*outputs, *previews)):
            for outputs, previews in takes:
                check_outputs(outputs, previews, inputs, overwrite=self.overwrite)
                check_written(self.apparel, outputs)
            self._make(replace(self._request(), sentence=prompts[0]), takes)
        return 0

    def _make(self, request: Request, takes: list[tuple[tuple[Path, ...], tuple[Path, ...]]]) -> None:
        """Make and write each take: its files and its previews."""
        with stages() as report:
            body, request = _ready(self, request, self.character, report)

            from bunraku.pipelines.animator import Animator

            animator = Animator.shipped(report, _limits_said(self.character, body))
            for take, (outputs, previews) in enumerate(takes):
                animation = animator(body, request.with_seed(self.sampling.seed + take))
                save_all(animation, outputs, previews, self.fps, report)

    def _long(self, sentence: Sentence) -> int:
        """Make a clip stretch by stretch, and write it as it comes."""
        named = self.output or (Path(f"{self.character.stem}-{slug(self.prompt[0])}.glb"),)
        if self.preview or self.takes > 1 or len(named) > 1:
            raise OptionError(
                f"a clip of more than {SECONDS.high:g} seconds goes into one GLB, without --preview and --takes; leave "
                "these out, or make it shorter"
            )
        with alone(named):
            check_outputs(named, (), [self.character], (".glb",), overwrite=self.overwrite)
            with stages() as report:
                body, request = _ready(self, self._request(), self.character, report)

                from bunraku.formats.gltf.stream import write_stretches
                from bunraku.pipelines.animator import Animator

                animator = Animator.shipped(report, _limits_said(self.character, body))
                stretches = animator.stretches(body, replace(request, sentence=sentence))
                written = write_stretches(stretches, named[0], fps=self.fps)
        wrote(written)
        note_written([written])
        return 0

    def _one_file(self, sentences: list[Sentence]) -> int:
        """Make the clips of one file."""
        inputs = [self.character] + ([self.directing.after] if self.directing.after else [])
        row = _preset(self.program)
        suffixes = ((".glb",) if self.add else (".glb", ".fbx")) if row is None else (row.suffix,)
        named = self.output or (Path(f"{self.character.stem}-{'clips' if row is None else row.name}{suffixes[0]}"),)
        if self.preview or self.takes > 1:
            raise OptionError("several clips in one file have neither --preview nor --takes; leave these out")

        from bunraku.pipelines.clips import clip_names, with_loops

        names = clip_names(sentence.prompt for sentence in sentences)
        files = named if row is None else tuple(file for path in named for file in row.files(path, names))
        with alone(files):
            for path in named:
                check_output(path, suffixes, [] if self.add else inputs)
            check_outputs(files, (), [] if self.add else inputs, suffixes, overwrite=self.overwrite or self.add)
            with stages() as report:
                body, request = _ready(self, self._request(), self.character, report)
                say = _limits_said(self.character, body)

                from bunraku.pipelines.animator import Animator

                requests = {
                    name: replace(request, sentence=sentence) for name, sentence in zip(names, sentences, strict=True)
                }
                clips = dict(Animator.shipped(report, say).clips(body, with_loops(requests)))
                save_clips_to(clips, named, self.fps, self.add, report, row)
        return 0

    def _request(self) -> Request:
        """What is requested; the clip that is followed is only named."""
        return Request(
            self.prompt[0] if self.prompt else "", self.sampling, self.directing.constraints(), self.apparel,
            fitting_stages(self.without, shape=True), self.handles, self.force, self.rig,
        )  # fmt: skip

    def _batch(self) -> bool:
        """Whether this makes clips in a folder."""
        return (self.prompts is not None and not self.one_file) or self.character.is_dir()

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
        same = ("output", "preview", "overwrite", "character", "prompt", "prompts", "jobs", "one_file", "add")
        options = {name: value for name, value in asdict(self).items() if name not in same}
        return fingerprint([character], "animate", prompt, options)

    def _prompts(self) -> list[Sentence]:
        """All prompts, parsed."""
        if self.prompts is not None and self.prompt:
            raise OptionError("a prompt and --prompts are both given; leave one out")
        if self.one_file and (self.prompts is None or self.character.is_dir()):
            raise OptionError("--one-file is for the lines of --prompts and one character; leave it out")
        if self.add and self._batch():
            raise OptionError("--add is for one file; say --one-file, or leave it out")
        if self._batch() and (self.preview or self.directing.after or len(self.output) > 1 or self.takes > 1):
            what = "--prompts" if self.prompts is not None else "a folder of characters"
            raise OptionError(f"{what} makes GLB files in one folder (-o), without --preview, --after and --takes")
        if self.prompts is None:
            if self.character.is_dir() and len(self.prompt) > 1:
                raise OptionError("a folder of characters takes one prompt, or the lines of --prompts")
            several = self.add or len(self.prompt) > 1
            said = self.prompt or ("",)
            return [check_sequence(prompt, self.sampling.seconds, self.force, several) for prompt in said]
        return read_lines(self.prompts, self.sampling.seconds, self.force, self.one_file)


def _clips(verb: Animate, clips: list[Clip]) -> Iterator[str]:
    """Make the clips of a pass; tell of each what went wrong, "" for nothing."""
    from bunraku.language.parse import parse
    from bunraku.pipelines.animator import Animator

    path, prompts = clips[0].character, clips[0].beside
    done = 0
    try:
        body, request = _kept(verb, path)
        sentences = [parse(prompt, verb.sampling.seconds, verb.force) for prompt in prompts]
        requests = [replace(request, sentence=sentence) for sentence in sentences]
        animations = Animator.shipped(note=_limits_said(path, body)).each(
            body, requests, {clip.number for clip in clips}
        )
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
    return _ready(verb, verb._request(), path, lambda stage, done: None)


def _ready(verb: Animate, request: Request, path: Path, report: Report) -> tuple[Body, Request]:
    """A character as it is to be animated, and what is requested of it."""
    from bunraku.io import load_character
    from bunraku.io.registry import check_writes

    report("load", 0.0)
    character = stand_up(load_character(path, unit="m", clips=verb.fps), path, verb.up, verb.front, verb.unit)
    for output in verb.output:
        if output.suffix:
            check_writes(output, character)
    report("load", 1.0)

    from bunraku.pipelines.animator import Animator

    if verb.skeleton is not None:
        from bunraku.pipelines.animate import with_skeleton

        character = with_skeleton(character, verb.skeleton, handles=verb.handles, progress=report)
        request = replace(request, handles="predict", rig="own")
    body = Animator.shipped(report).body(character, request)
    row = _preset(verb.program)
    if row is not None and verb.rig == "auto" and verb.skeleton is None and body.takes_skeleton:
        from bunraku.retarget.engine_skeleton import on_skeleton

        request = replace(request, handles="predict", rig="own")
        body = Animator.shipped(report).body(on_skeleton(body.anatomy, row.skeleton), request)
    if verb.directing.after is not None:
        before = _before(verb.directing.after, character, body.anatomy.handles)
        request = replace(request, constraints=request.constraints.following(before))
    return body, request


def _preset(program: str | None) -> Preset | None:
    if program is None:
        return None
    from bunraku.io.presets import preset_named

    return preset_named(program)


def _limits_said(path: Path, body: Body) -> Callable[[str], None]:
    """Say on standard error what moves the body, where these are its own bones; gives what says there, each once, what
    it cannot do.
    """
    if body.parts is not None:
        print(f"{path}: its own {len(body.parts.parts)} bones move it (--rig handles for 30 handles)", file=sys.stderr)

    @cache
    def say(note: str) -> None:
        print(f"{path}: {note}", file=sys.stderr)

    return say


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
