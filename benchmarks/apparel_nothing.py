"""How much of machines, animals and bare bodies is taken for apparel, where there is none.

    python benchmarks/apparel_nothing.py ARCHIVE            measures the files of apparel_nothing.txt
    python benchmarks/apparel_nothing.py ARCHIVE --draw     draws them anew: seven machines, seven animals, six bodies

ARCHIVE is the folder of the characters' archive. The list was drawn by lot and committed before anything was measured
on it. Bodies are people in close clothes and creatures without any.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.apparel.mask import artist_mask
from bunraku.files import load_character
from bunraku.pipelines.animate import rig
from bunraku.pipelines.clothes import body_of_handles, may_have_apparel, separate_apparel

LIST = Path(__file__).with_suffix(".txt")
MACHINES = ("quaternius/mech_pack/*.glb", "quaternius2019/Robot.glb")
ANIMALS = (
    "quaternius/animals_pack/*.glb", "quaternius/dinosaurs_pack/*.glb", "quaternius/fish_pack/*.glb",
    *(f"quaternius2019/{name}.glb" for name in ("Cat", "Cow", "Dog", "Horse", "Llama", "Pig", "Pug", "Red_Fox", "Sheep",
                                                "Whale", "Wolf", "Zebra", "Eagle", "Dragon")),
)  # fmt: skip
BODIES = (
    *(f"quaternius2019/{name}.glb" for name in ("Alien", "Animated_Human", "Male_Casual", "Male_LongSleeve",
                                                "Male_Shirt", "Male_Suit", "Skeleton", "Zombie", "Goblin")),
    "valid/*_M_*.glb",
)  # fmt: skip


def draw(archive: Path) -> None:
    """Write the list."""
    rng = np.random.default_rng(2811)
    lines = []
    for patterns, count in ((MACHINES, 7), (ANIMALS, 7), (BODIES, 6)):
        files = sorted({path for pattern in patterns for path in archive.glob(pattern)})
        chosen = rng.choice(len(files), min(count, len(files)), replace=False)
        lines += sorted(files[number].relative_to(archive).as_posix() for number in chosen)
    LIST.write_text("\n".join(lines) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("archive", type=Path)
    parser.add_argument("--draw", action="store_true")
    asked = parser.parse_args()
    if asked.draw:
        draw(asked.archive)
        return
    shares = []
    for line in LIST.read_text().split():
        character = load_character(asked.archive / line)
        assert artist_mask(character) is None
        handles, share = rig(character), 0.0
        if may_have_apparel(Anatomy.of(character, handles)):
            weights, joints = body_of_handles(character, handles)
            share = separate_apparel(character, joints, weights, None).apparel.mean()
        shares.append(share)
        print(f"{line}: {100 * shares[-1]:.1f} %", flush=True)
    print(f"mean {100 * np.mean(shares):.2f} %, worst {100 * max(shares):.1f} %, "
          f"{sum(share > 0.02 for share in shares)} of {len(shares)} over 2 %")  # fmt: skip


if __name__ == "__main__":
    main()
