"""`bunraku evaluate handles`: the table of the Mesh Handle Predictor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from bunraku.cli.output.checks import check_input, check_source
from bunraku.cli.output.progress import stages
from bunraku.errors import OptionError
from bunraku.nn.spread import parse_jobs
from bunraku_lab.cli.evaluate.printed import Printed
from bunraku_lab.evaluation.report import Report, bar_table

__all__ = ["EvaluateHandles"]


@dataclass(frozen=True)
class EvaluateHandles(Printed):
    """Measure how good the predicted handles are, on rigged characters whose own rigs are the truth.

    Without --characters, 30 characters are made by code, of seeds that no training sees.

    Example: bunraku evaluate handles --characters archive/characters --json
    """

    characters: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Folder of rigged characters, searched through. Of the training archive only those that no training sees are
    taken.
    """
    avatars: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Folder of avatars (PMX, VRM) for the list of detailed people, searched through. Without it those of the archive
    and of the wardrobe are taken.
    """
    all: bool = False
    """Take every character of the folder, those that were trained on too."""
    checkpoint: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Weights of the handle predictor. Default: the shipped ones."""
    no_baselines: bool = False
    """Leave out the clusters and the bone heat to which the pose error is compared."""
    no_speed: bool = False
    """Leave out the time that predictions take, which says little on a busy machine."""
    seed: int = 0
    """Of the random poses and the clusters."""
    jobs: Annotated[str, tyro.conf.arg(metavar="{N,ray}")] = "1"
    """How many processes share the characters, or "ray" for a Ray cluster."""

    def run(self) -> None:
        check_source(self.characters, "give one with rigged characters")
        check_source(self.avatars, "give one with avatars")
        if self.all and self.characters is None:
            raise OptionError("--all needs --characters, the folder to take all characters of")
        if self.seed < 0:
            raise OptionError(f"--seed must be 0 or more, not {self.seed}")
        if self.checkpoint is not None:
            check_input(self.checkpoint)
        jobs = parse_jobs(self.jobs)
        from bunraku_lab.evaluation.handles.detailed import detailed_subjects
        from bunraku_lab.evaluation.handles.table import code_made_subjects, evaluate_handles, folder_subjects

        subjects = code_made_subjects() if self.characters is None else folder_subjects(self.characters, self.all)
        with stages() as report:
            result = evaluate_handles(
                subjects,
                detailed=detailed_subjects(self.characters, self.avatars),
                checkpoint=self.checkpoint,
                baselines=not self.no_baselines,
                speed=not self.no_speed,
                seed=self.seed,
                jobs=jobs,
                progress=report,
            )
        self.show(result, _report)


def _report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.handles.table import BARS

    counts = result["counts"]
    return Report([
        f"{counts['characters']} characters, {counts['humanoids']} humanoids; resolutions on {counts['resampled']}; "
        f"{counts['detailed']} detailed people",
        bar_table(BARS, result, reached=result["reached"]),
        *(f"left out {name}: {reason}" for name, reason in result["left_out"].items()),
    ])  # fmt: skip
