"""Make the sheets of docs/creatures.md: `python tools/make_creature_pictures.py [NAME ...] --characters DIR`, in
docs/pictures, at most 300 kB each.

`captured` puts the walk and the gallop of animals, written as captured skeletons, on the sample dog and on others;
`gaits` shows a spider's legs; `ways` bodies that fly, slither, swim and crawl; `page` what
`bunraku rig --preview` says.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import bunraku
from bunraku.cli import main as bunraku_command
from bunraku.core.animation import Animation
from bunraku.files import load_animation, sample_character, save_character
from bunraku.pipelines.animate import animate, rig
from bunraku.render import contact_sheet, render_animation
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.evaluation.transfer.character import facing_character
from bunraku_lab.evaluation.transfer.quadrupeds import captured_animal
from bunraku_lab.synthetic.families import EVALUATION_SEED, code_made_character

OUT = Path(__file__).parents[1] / "docs/pictures"
SIZE = (190, 170)
SHOWN = 6
SOURCE = "quaternius/animals_pack/ShibaInu"
CLIPS = (("walk", "AnimalArmature|Walk"), ("gallop", "AnimalArmature|Gallop"))
TARGETS = ("quaternius/animals_pack/Bull", "quaternius2019/Horse")


def frames(animation: Animation, shown: int = SHOWN) -> list[np.ndarray]:
    """Pictures evenly over an animation."""
    rate = max(6.0, 2 * shown / animation.motion.duration)  # short cycles want more
    pictures = list(render_animation(animation, size=SIZE, fps=min(rate, 30.0)))
    return [pictures[number] for number in np.linspace(0, len(pictures) - 1, shown).round().astype(int)]


def captured(characters: Path) -> None:
    """Captured animals on animals that no training of handles saw."""
    own = facing_character(characters / f"{SOURCE}.glb", SOURCE)
    parts = RigParts.of(own)
    bodies = {"sample dog": sample_character("dog")}
    bodies |= {name.split("/")[-1]: facing_character(characters / f"{name}.glb", name) for name in TARGETS}
    images: list[np.ndarray] = []
    labels: list[str] = []
    for title, label in CLIPS:
        clip = captured_animal(load_animation(characters / f"{SOURCE}.glb", label, 30.0), parts)
        for name, body in bodies.items():
            result = bunraku.transfer(body, clip.motion, onto="handles")
            assert isinstance(result, Animation)
            images += frames(result)
            labels += [f"{name}, {title}"] + [""] * (SHOWN - 1)
    contact_sheet(
        images, labels, OUT / "creatures-captured.png", columns=SHOWN, title="A Shiba Inu's clips as captured BVH"
    )


def gaits(characters: Path) -> None:
    """Legs of a spider that take turns."""
    name = "quaternius/easy_enemies_pack/Spider"
    body = facing_character(characters / f"{name}.glb", name)
    walk = animate(body, "walks forward", seconds=2, seed=1)
    assert isinstance(walk, Animation)
    contact_sheet(frames(walk, 10), None, OUT / "creatures-gait.png", columns=5, title="a spider walks forward")


def ways(characters: Path) -> None:
    """Bodies that fly, slither, swim and crawl as each does, and flight that goes from one winged body to another."""
    fish, spider = "quaternius/cute_fish_pack/Tuna", "quaternius/easy_enemies_pack/Spider"
    bodies = {
        "a dragon flies": sample_character("dragon"),
        "a bird flies": replace(code_made_character("bird", EVALUATION_SEED + 2), rig=None),
        "a snake slithers": replace(code_made_character("snake", EVALUATION_SEED + 21), rig=None),
        "a fish swims": facing_character(characters / f"{fish}.glb", fish),
        "a spider crawls": facing_character(characters / f"{spider}.glb", spider),
    }
    images: list[np.ndarray] = []
    labels: list[str] = []
    for sentence, body in bodies.items():
        moved = animate(body, sentence, seconds=2, seed=1, handles=rig(body))
        assert isinstance(moved, Animation)
        images += frames(moved)
        labels += [sentence] + [""] * (SHOWN - 1)
    contact_sheet(images, labels, OUT / "creatures-ways.png", columns=SHOWN, title="each in its own way")


def page(characters: Path) -> None:
    """What was decided about the sample dog."""
    path = OUT / "dog.glb"
    save_character(sample_character("dog"), path)
    try:
        words = ["rig", str(path), "-o", str(OUT / "dog-rigged.glb"), "--preview", str(OUT / "creatures-page.png")]
        bunraku_command([*words, "--overwrite"])
    finally:
        for left in (path, OUT / "dog-rigged.glb", OUT / ".bunraku-ledger.jsonl"):
            left.unlink(missing_ok=True)


PICTURES: dict[str, Callable[[Path], None]] = {
    "captured": captured,
    "gaits": gaits,
    "ways": ways,
    "page": page,
}


def main() -> None:
    """Make all sheets, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[[], *PICTURES], default=[])
    parser.add_argument("--characters", type=Path, required=True)
    given = parser.parse_args()
    for name in given.names or PICTURES:
        PICTURES[name](given.characters)


if __name__ == "__main__":
    main()
