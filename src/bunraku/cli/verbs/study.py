"""`bunraku study make`: a blind study of what methods made of the same sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.cli.output.checks import check_input
from bunraku.cli.output.progress import Report, stages
from bunraku.core.request.limits import SECONDS
from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.studio.study.make import Line

__all__ = ["StudyMake"]

MethodOption = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=FOLDER"), tyro.conf.UseAppendAction]


@dataclass(frozen=True)
class StudyMake:
    """Make a blind study as TapMo's Table 3: people see the methods' clips of a sentence side by side, in an order by
    Latin square, and rank them.

    A method is a name with a folder of GLBs, 1.glb for the first line of the sentences and so on. A method without a
    folder is Bunraku itself, which makes its clips of --characters. Two trials are checks: a clip that does not move,
    and a trial that comes again.

    Example: bunraku study make --method ours --method mdm-sr=clips/mdm-sr --characters characters --prompts
    sentences.txt -o study
    """

    prompts: Path
    """A text file with a trial a line: "dragon.glb: walks forward"."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to."""
    method: MethodOption = ()
    """A method: its name and the folder of its clips, or the name alone for Bunraku's own. Given at least twice."""
    characters: Path | None = None
    """Folder of the characters, for Bunraku's own clips."""
    seconds: float = 6.0
    """Length of Bunraku's own clips, 0.5 to 120."""
    seed: int = 0
    """Of Bunraku's own clips, and of which trials are checks."""

    def run(self) -> None:
        from bunraku.studio.study.make import make_study, read_lines

        check_input(self.prompts)
        SECONDS.check(self.seconds, "--seconds")
        lines = read_lines(self.prompts)
        methods: dict[str, Path] = {}
        for text in self.method:
            name, equals, folder = text.partition("=")
            if name in methods:
                raise OptionError(f"--method {name} is given twice")
            if equals and not Path(folder).is_dir():
                raise OptionError(f"--method {text}: {folder} is no folder")
            methods[name] = Path(folder) if equals else self.output / "made" / name
        if len(methods) < 2:
            raise OptionError("a study compares at least two methods; give --method twice or more")
        own = [text for text in self.method if "=" not in text]
        if own and self.characters is None:
            raise OptionError(f"--method {own[0]} has no folder, so its clips are made here; name --characters")
        for line in lines:
            if own and self.characters is not None:
                check_input(self.characters / line.character)
        with stages() as report:
            for name in own:
                self._make(methods[name], lines, report)
            make_study(methods, lines, self.output, seed=self.seed, progress=report)
        print(f"wrote {self.output}; show it with: bunraku studio --study {self.output}")

    def _make(self, folder: Path, lines: Sequence[Line], report: Report) -> None:
        from bunraku.cli.options.orientation import stand_up
        from bunraku.formats.files import writing
        from bunraku.io import load_character
        from bunraku.pipelines.animate import animate

        with writing(folder, "folder"):
            folder.mkdir(parents=True, exist_ok=True)
        assert self.characters is not None
        for number, line in enumerate(lines, 1):
            report("animate", (number - 1) / len(lines))
            target = folder / f"{number}.glb"
            if target.is_file():
                continue  # of a run that was stopped
            path = self.characters / line.character
            character = stand_up(load_character(path, unit="m"), path)
            animate(character, line.prompt, seconds=self.seconds, seed=self.seed).save(target)
