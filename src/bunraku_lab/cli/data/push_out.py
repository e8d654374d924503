"""`bunraku data push-out`: apparel data whose truth is repaired without being simulated again."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from bunraku.cli.output.checks import check_folder
from bunraku.cli.output.progress import stages
from bunraku.errors import OptionError
from bunraku_lab.cli.data.apparel import process_count

if TYPE_CHECKING:
    from bunraku_lab.datasets.apparel.repair import RepairState

__all__ = ["PushOutData"]


@dataclass(frozen=True)
class PushOutData:
    """Push the apparel of a data set out of the bodies that wear it, into another folder, without simulating it again.

    What `bunraku data apparel` writes now is so already. Says how much of the apparel was deeper than 1 cm in the body
    before and after. A second run goes on where the first one stopped.

    Example: bunraku data push-out data/apparel -o data/apparel-out --jobs 2
    """

    data: Annotated[Path, tyro.conf.Positional]
    """Folder that `bunraku data apparel` wrote."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to, made when it is not there."""
    jobs: Annotated[str | None, tyro.conf.arg(metavar="{N,ray}", help_behavior_hint="")] = None
    """How many processes, or "ray" for a Ray cluster. Default: one for each core."""

    def run(self) -> int:
        jobs = process_count(self.jobs)
        check_folder(self.output)
        if self.data.resolve() == self.output.resolve():
            raise OptionError("the repaired data need a folder of their own; name another with -o")
        from bunraku_lab.datasets.apparel.repair import repair_apparel

        with stages() as report:

            def tell(state: RepairState) -> None:
                report("apparel", (state.done + len(state.failed)) / max(state.shards, 1))

            state = repair_apparel(self.data, self.output, jobs=jobs, progress=tell)
        for name, reason in state.failed.items():
            print(f"left out {name}: {reason}", file=sys.stderr)
        rigid, before, after = 100 * np.mean(state.inside or [[0.0, 0.0, 0.0]], axis=0)
        print(
            f"wrote {state.done} of {state.shards} files to {self.output}; deeper than 1 cm in the body: "
            f"{before:.2f} % of the apparel before, {after:.2f} % after, {rigid:.2f} % were it rigid"
        )
        return 0 if state.done == state.shards else 2
