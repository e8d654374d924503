"""`bunraku animate --prompts`: one clip for each line of a file, several in one pass of the network."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.cli.checks import check_folder, check_input, check_sequence, slug
from bunraku.cli.evaluate.report import wrote
from bunraku.cli.orientation import stand_up
from bunraku.cli.progress import stages
from bunraku.errors import FormatError, OptionError

if TYPE_CHECKING:
    from bunraku.cli.verbs.animate import Animate
    from bunraku.core.animation import Animation
    from bunraku.core.rig_animation import RigAnimation
    from bunraku.retarget.fit import Stages

__all__ = ["animate_lines", "read_lines"]

AT_ONCE = 8
LIMIT = 10_000


def read_lines(path: Path, seconds: float) -> list[str]:
    """The prompts of a text file, one a line; empty lines do not count.

    Raises:
        FormatError: The file is missing, or is no text.
        OptionError: It holds no prompt or too many, or one cannot be generated; the message names its line.
    """
    check_input(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise FormatError(path, "this is no text in UTF-8; save it as plain text with one prompt a line") from None
    prompts = []
    for number, line in enumerate(lines, 1):
        if line.strip():
            try:
                check_sequence(line, seconds)
            except OptionError as error:
                raise OptionError(f"{path}, line {number}: {error}") from None
            prompts.append(line.strip())
    if not 1 <= len(prompts) <= LIMIT:
        raise OptionError(f"{path} holds {len(prompts):,} prompts; give 1 to {LIMIT:,}, one a line")
    return prompts


def animate_lines(options: Animate, prompts: list[str], fitting: Stages | None) -> None:
    """Write a GLB for each prompt that has none yet.

    Args:
        options: Those of `bunraku animate`.
        prompts: One for each file, which is named after its number and words.
        fitting: Which stages fit the motions to the character.
    """
    folder = options.output[0] if options.output else Path(f"{options.character.stem}-clips")
    if folder.is_file():
        raise FormatError(folder, "this is a file; name a folder with -o, where each prompt gets a file")
    check_folder(folder)
    files = [folder / f"{number:03d}-{slug(prompt)}.glb" for number, prompt in enumerate(prompts, 1)]
    todo = [(path, prompt) for path, prompt in zip(files, prompts, strict=True) if not path.is_file()]
    if len(todo) < len(files):
        print(f"{len(files) - len(todo)} of {len(files)} clips are there already")
    if not todo:
        return
    from bunraku.handles.predict import mesh_feature
    from bunraku.io import load_character
    from bunraku.physics.animated import check_apparel
    from bunraku.pipelines.animate import generate, rig
    from bunraku.pipelines.apply import perform, perform_dressed

    with stages() as report:
        report("load", 0.0)
        character = stand_up(load_character(options.character), options.character, options.up, options.front)
        report("load", 1.0)
        dressed = options.apparel == "simulate"
        if dressed:
            check_apparel(character)
        handles = None if dressed else rig(character, handles=options.handles, progress=report)
        feature = mesh_feature(character) if handles is None else handles.features
        folder.mkdir(exist_ok=True)
        for start in range(0, len(todo), AT_ONCE):
            some = todo[start : start + AT_ONCE]
            motions = generate(  # the same seed for each, so that a clip does not depend on those beside it
                [prompt for _, prompt in some], seconds=options.seconds, seed=[options.seed] * len(some), steps=options.steps,
                guidance=options.guidance, mesh_feature=feature, loop=options.loop,
            )  # fmt: skip
            for done, ((path, _), motion) in enumerate(zip(some, motions, strict=True), start):
                animation: Animation | RigAnimation
                if handles is None:
                    animation = perform_dressed(motion, character, in_place=options.in_place, stages=fitting)
                else:
                    animation = perform(motion, character, handles, loop=options.loop, in_place=options.in_place, stages=fitting)
                wrote(animation.save(path, fps=options.fps))
                report("clips", (done + 1) / len(todo))
