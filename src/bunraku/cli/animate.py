"""`bunraku animate`: a character and a sentence give an animation, or many sentences and many characters."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bunraku.cli import options, shared
from bunraku.cli.manifest import exclusive_output, fingerprint, is_result
from bunraku.core.request import SECONDS, TAKES, Progress
from bunraku.errors import FormatError, OptionError, sentence_of
from bunraku.pipelines.requests import Request
from bunraku.retarget.stages import Stages

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter
    from bunraku.core.character import Character, Handles
    from bunraku.core.motion import HandleMotion
    from bunraku.files import Preset
    from bunraku.language.sentence import Sentence
    from bunraku.pipelines.animator import Body

LIMIT = 10_000


def read_lines(path: Path, seconds: float | None, force: bool, named: bool = False) -> list[Sentence]:
    """The sentences of a text file, one a line, before which the name of a clip may stand where they are `named`; empty
    lines do not count.

    Raises:
        FormatError: The file is missing, or is no text.
        OptionError: It holds no prompt or too many, or one cannot be generated; the message names its line.
    """
    shared.check_input(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise FormatError(path, "this is not text in UTF-8; save it as plain text with one prompt a line") from None
    prompts = []
    for number, line in enumerate(lines, 1):
        if line.strip():
            try:
                prompts.append(shared.check_sequence(line.strip(), seconds, force, named))
            except OptionError as error:
                raise type(error)(f"{path}, line {number}: {error}") from None
    if not 1 <= len(prompts) <= LIMIT:
        raise OptionError(f"{path} holds {len(prompts):,} prompts; give 1 to {LIMIT:,}, one a line")
    return prompts


def characters_of(folder: Path) -> dict[Path, str]:
    """The characters of a folder, by their suffixes, each with the name of its own folder of results; what Bunraku
    animated is none. FormatError where there is no character, or the folder cannot be read.
    """
    from bunraku.files import READERS

    readers = READERS["character"]
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in readers and path.is_file())
        paths = [path for path in paths if not is_result(path)]
    except OSError as error:
        raise FormatError(folder, f"this folder cannot be read ({error.strerror}); name another") from None
    if not paths:
        raise FormatError(folder, "no character lies in this folder; name one with meshes, such as .glb")
    stems = [path.stem.lower() for path in paths]
    return {path: path.stem if stems.count(path.stem.lower()) == 1 else path.name for path in paths}


@dataclass(frozen=True)
class Clip(shared.Result):
    """A clip of one prompt; the character is the first of its `inputs`."""

    number: int = 0  # which of the prompts of its pass it shows
    # All prompts of that pass, which are generated along, so that a clip has the same bytes whether those beside it are
    # wanted or not.
    beside: tuple[str, ...] = ()


def clips_of(
    folder: Path, character: Path, prompts: list[str], at_once: int, mark: Callable[[Path, str], str]
) -> list[Clip]:
    """A clip of the character of a file for each prompt, its file in the folder named after its number and words.
    `mark` gives the fingerprint of a character's clip of a prompt, and `at_once` prompts go through one pass of the
    network.
    """
    out = []
    for number, prompt in enumerate(prompts):
        first = number - number % at_once
        beside = tuple(prompts[first : first + at_once])
        path = folder / f"{number + 1:03d}-{shared.slug(prompt)}.glb"
        out.append(Clip(path, (character,), mark(character, prompt), number - first, beside))
    return out


def passes(clips: list[Clip]) -> list[list[Clip]]:
    """The clips, those of one pass of the network together."""
    out: list[list[Clip]] = []
    for clip in clips:
        last = out[-1][-1] if out else None
        if last and (last.inputs, last.beside) == (clip.inputs, clip.beside) and last.number < clip.number:
            out[-1].append(clip)
        else:
            out.append([clip])
    return out


@dataclass(frozen=True)
class Animate(options.GeneratingOptions):
    """Make a character do what a sentence says.

    The character is a .glb, .gltf, .vrm, .pmx, .pmd, .fbx, .obj, .ply or .stl file; it needs no rig. The animation is
    written as a GLB that keeps the mesh, materials and textures of the input, as an NPZ of the handle motion, or as a
    sequence of meshes.

    Several prompts in a row, separated by semicolons, blend into each other: "walks:4; jumps:2; waves:3". The numbers
    are seconds.

    Several prompts make as many clips in one file, as game engines take them; walks and other cycles become loops:
    bunraku animate knight.glb "idle" "walks forward" "runs" "Attack=attacks" -o knight-moves.glb

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
    apparel: tyro.conf.OmitArgPrefixes[options.ApparelOptions] = field(default_factory=options.ApparelOptions)
    """How hair and clothes move."""
    rig: Literal["auto", "own", "handles"] = "auto"
    """What is moved. "own": the bones of the file's skeleton, which keeps its names, weights and other clips.
    "handles": the 30 handles. "auto": the bones where Bunraku understands them (of a person, a four-legged animal or a
    bird), the handles elsewhere.
    """
    skeleton: options.SkeletonOption = None
    program: options.ProgramOption = None
    """Write the file that a program wants: its format, axes and unit, frame rate, names of joints for persons without a
    skeleton of their own, and where the travel is (docs/engines.md). A prompt of a walk or another cycle makes a loop.
    """
    directing: tyro.conf.OmitArgPrefixes[options.DirectingOptions] = field(default_factory=options.DirectingOptions)
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
            shared.check_input(self.character)
        after = self.directing.after
        if after is not None:
            shared.check_input(after)
        self.apparel.check("--")
        shared.check_mask(self.apparel)
        self._request().check("--")
        if self.skeleton is not None and self.rig != "auto":
            raise OptionError("--skeleton says what is moved; leave out --rig")
        TAKES.check(self.takes, "--takes")
        jobs = options.parse_jobs(self.jobs)
        if batch:
            return self._many([sentence.prompt for sentence in prompts], jobs)
        if jobs != 1:
            raise OptionError("--jobs shares the clips of --prompts, or of a folder of characters; leave it out")
        if several:
            return self._one_file(prompts)
        if prompts[0].seconds > SECONDS.high:
            return self._long(prompts[0])
        named = self.output or (Path(f"{self.character.stem}-{shared.slug(self.prompt[0])}.glb"),)
        takes = [_numbered(named, self.preview, take, self.takes) for take in range(self.takes)]
        inputs = [self.character] + ([after] if after else [])
        with exclusive_output(shared.written_path(path) for take in takes for paths in take for path in paths):
            for outputs, previews in takes:
                shared.check_outputs(outputs, previews, inputs, overwrite=self.overwrite)
                shared.check_written(self.apparel, outputs)
            self._make(replace(self._request(), sentence=prompts[0]), takes)
        return 0

    def _make(self, request: Request, takes: list[tuple[tuple[Path, ...], tuple[Path, ...]]]) -> None:
        """Make and write each take: its files and its previews."""
        with shared.stages() as report:
            body, request = _ready(self, request, self.character, report)

            from bunraku.pipelines.animator import Animator

            animator = Animator.shipped(report, _limits_said(self.character, body))
            for take, (outputs, previews) in enumerate(takes):
                animation = animator(body, request.with_seed(self.sampling.seed + take))
                shared.save_all(animation, outputs, previews, self.fps, report)

    def _long(self, sentence: Sentence) -> int:
        """Make a clip stretch by stretch, and write it as it comes."""
        named = self.output or (Path(f"{self.character.stem}-{shared.slug(self.prompt[0])}.glb"),)
        if self.preview or self.takes > 1 or len(named) > 1:
            raise OptionError(
                f"a clip of more than {SECONDS.high:g} seconds goes into one GLB, without --preview and --takes; leave "
                "these out, or make it shorter"
            )
        with exclusive_output(named):
            shared.check_outputs(named, (), [self.character], (".glb",), overwrite=self.overwrite)
            with shared.stages() as report:
                body, request = _ready(self, self._request(), self.character, report)

                from bunraku.files import write_stretches
                from bunraku.pipelines.animator import Animator

                animator = Animator.shipped(report, _limits_said(self.character, body))
                stretches = animator.stretches(body, replace(request, sentence=sentence))
                with shared.written_files() as written:
                    written.append(write_stretches(stretches, named[0], fps=self.fps))
        return 0

    def _one_file(self, sentences: list[Sentence]) -> int:
        """Make the clips of one file."""
        inputs = [self.character] + ([self.directing.after] if self.directing.after else [])
        row = _preset(self.program)
        suffixes = ((".glb",) if self.add else (".glb", ".fbx")) if row is None else (row.suffix,)
        named = self.output or (Path(f"{self.character.stem}-{'clips' if row is None else row.name}{suffixes[0]}"),)
        if self.preview or self.takes > 1:
            raise OptionError("several clips in one file have neither --preview nor --takes; leave these out")

        from bunraku.pipelines.requests import clip_names, with_loops

        names = clip_names(sentence.prompt for sentence in sentences)
        files = named if row is None else tuple(file for path in named for file in row.files(path, names))
        with exclusive_output(files):
            for path in named:
                shared.check_output(path, suffixes, [] if self.add else inputs)
            shared.check_outputs(files, (), [] if self.add else inputs, suffixes, overwrite=self.overwrite or self.add)
            with shared.stages() as report:
                body, request = _ready(self, self._request(), self.character, report)
                say = _limits_said(self.character, body)

                from bunraku.pipelines.animator import Animator

                requests = {
                    name: replace(request, sentence=sentence) for name, sentence in zip(names, sentences, strict=True)
                }
                clips = dict(Animator.shipped(report, say).clips(body, with_loops(requests)))
                shared.save_clips_to(clips, named, self.fps, self.add, report, row)
        return 0

    def _request(self) -> Request:
        """What is requested; the clip that is followed is only named."""
        return Request(
            self.prompt[0] if self.prompt else "", self.sampling, self.directing.constraints(), self.apparel,
            Stages(shape=True).without(self.without, "--without"), self.handles, self.force, self.rig,
        )  # fmt: skip

    def _batch(self) -> bool:
        """Whether this makes clips in a folder."""
        return (self.prompts is not None and not self.one_file) or self.character.is_dir()

    def _many(self, prompts: list[str], jobs: int | str) -> int:
        if self.character.is_dir():
            characters = characters_of(self.character)
        else:
            shared.check_input(self.character)
            characters = {self.character: ""}
        folder = self.output[0] if self.output else Path(f"{self.character.resolve().stem or 'all'}-clips")
        if folder.is_dir() and self.character.is_dir() and folder.samefile(self.character):
            raise OptionError(f"the clips would lie among the characters of {folder}; name another folder with -o")
        with exclusive_output(folders=[folder]):
            return self._fill(folder, characters, prompts, jobs)

    def _fill(self, folder: Path, characters: dict[Path, str], prompts: list[str], jobs: int | str) -> int:
        """Make the clips of a folder that are not there yet."""
        from bunraku.pipelines.animator import AT_ONCE

        if self.character.is_dir() and not folder.is_file():
            shared.check_folder(folder)
            folder.mkdir(exist_ok=True)  # each character gets a folder in it
        clips: list[Clip] = []
        for character, name in characters.items():
            target = folder / name
            if target.is_file():
                raise FormatError(target, "this is a file; name a folder with -o, where each prompt gets a file")
            shared.check_folder(target)
            clips += clips_of(target, character, prompts, AT_ONCE, self._mark)
        todo = shared.unfinished_results(clips, self.overwrite, "clips")
        mask = self.apparel.mask
        here = self if mask is None else replace(self, apparel=replace(self.apparel, motion=str(mask.resolve())))
        with shared.stages() as report:
            if todo and len(characters) == 1 and jobs == 1:  # its faults end the command before any clip is begun
                _kept(here, next(iter(characters)))
            return shared.make_results(partial(_clips, here), passes(todo), jobs, "clips", report)

    def _mark(self, character: Path, prompt: str) -> str:
        """What a clip is made of."""
        same = {"output", "preview", "overwrite", "character", "prompt", "prompts", "jobs", "one_file", "add"}
        facts = {name: value for name, value in asdict(self).items() if name not in same}
        return fingerprint([character], "animate", prompt, facts)

    def _prompts(self) -> list[Sentence]:
        """All prompts, parsed."""
        if self.prompts is not None and self.prompt:
            raise OptionError("a prompt and --prompts are both given; leave one out")
        if self.one_file and (self.prompts is None or self.character.is_dir()):
            raise OptionError("--one-file is for the lines of --prompts and one character; leave it out")
        if self.add and self._batch():
            raise OptionError("--add is for one file; say --one-file, or leave it out")
        if self._batch() and (self.preview or self.directing.after or len(self.output) > 1 or self.takes > 1):
            subject = "--prompts" if self.prompts is not None else "a folder of characters"
            raise OptionError(f"{subject} makes GLB files in one folder (-o), without --preview, --after and --takes")
        seconds = self._request().seconds
        if self.prompts is None:
            if self.character.is_dir() and len(self.prompt) > 1:
                raise OptionError("a folder of characters takes one prompt, or the lines of --prompts")
            several = self.add or len(self.prompt) > 1
            _check_quotes(self.prompt)
            prompts = self.prompt or ("",)
            return [shared.check_sequence(prompt, seconds, self.force, several) for prompt in prompts]
        return read_lines(self.prompts, seconds, self.force, self.one_file)


def _check_quotes(words: Sequence[str]) -> None:
    """Raise OptionError where words that are clips of their own make sense as a sentence only."""
    from bunraku.language.parse import parse

    if len(words) > 1 and all(word.isalpha() for word in words):
        whole = " ".join(words)
        sentences = [parse(text, 2.0, True) for text in (whole, *words)]
        clear, *each = (not (sentence.notes or sentence.unknown) for sentence in sentences)
        # clips that all show the one action of the whole are not what is asked for
        acts = [{action for clause in sentence.clauses for action in clause.actions} for sentence in sentences]
        if clear and not (all(each) and any(said != acts[0] or len(said) > 1 for said in acts)):
            raise OptionError(f'a sentence of several words stands in quotes: "{whole}"')


def _clips(verb: Animate, clips: list[Clip]) -> Iterator[str]:
    """Make the clips of a pass, and give for each what went wrong, "" for nothing."""
    from bunraku.language.parse import parse
    from bunraku.pipelines.animator import Animator

    (path,), prompts = clips[0].inputs, clips[0].beside
    done = 0
    try:
        body, request = _kept(verb, path)
        sentences = [parse(prompt, request.seconds, verb.force) for prompt in prompts]
        requests = [replace(request, sentence=sentence) for sentence in sentences]
        animations = Animator.shipped(note=_limits_said(path, body)).each(
            body, requests, {clip.number for clip in clips}
        )
        for clip in clips:
            next(animations).save(clip.path, fps=verb.fps)
            done += 1
            yield ""
        return
    except Exception as error:  # a bad file does not stop the others
        reason = sentence_of(error)
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


def _ready(verb: Animate, request: Request, path: Path, report: Progress) -> tuple[Body, Request]:
    """A character as it is to be animated, and what is requested of it."""
    from bunraku.core.avatars import MmdModel
    from bunraku.files import check_writer

    report("load", 0.0)
    character = verb.standing.load(path, clips=verb.fps)
    for output in verb.output:
        if output.suffix:
            check_writer(output, mmd=isinstance(character.avatar, MmdModel))
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
    from bunraku.files import preset_named

    return preset_named(program)


def _limits_said(path: Path, body: Body) -> Callable[[str], None]:
    """Say on standard error what moves the body, where these are bones; gives what says there, each once, what it
    cannot do.
    """
    if body.parts is not None:
        own = getattr(body.character.source, "moved", None) is None  # a skeleton that is given bends the mesh to it
        said = (
            "its own {} bones move it (--rig handles for 30 handles)" if own else "{} bones that it was given move it"
        )
        print(f"{path}: {said.format(len(body.parts.parts))}", file=sys.stderr)

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
    from bunraku.files import load_clip

    clip = load_clip(path)
    return clip.on(character, handles) or clip.of_the_reference_body()
