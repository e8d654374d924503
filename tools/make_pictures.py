"""Make the pictures of the docs: `python tools/make_pictures.py [NAME ...] [--characters DIR]`, in docs/pictures, at
most 300 kB each.

Everything is drawn from the shipped weights and the sample characters, so anyone can make them again; the sheet of
handles and the gallery from the character archive, where its folder is given.
"""

from __future__ import annotations

import argparse
import csv
import functools
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import bunraku
from bunraku.core.character import Character
from bunraku.files import sample_character, sample_names
from bunraku.generation.features import body_handle_motion
from bunraku.gestures.catalogue import gestures as all_gestures
from bunraku.gestures.play import gesture_motion
from bunraku.pipelines.animate import animate, rig
from bunraku.render import contact_sheet, render_animation, render_still

OUT = Path(__file__).parents[1] / "docs/pictures"
PROMPTS = (
    "a person walks forward",
    "a person runs forward",
    "a person jumps forward",
    "a person waves with the right hand",
    "a person kicks with the left leg",
    "a person does a squat",
    "a person turns around",
    "a person dances",
    "a person sits down on the floor",
    "a person walks backwards",
    "a person does jumping jacks",
    "a person punches",
)
STORIES = (
    ("person", "walks forward, then waves with the left hand"),
    ("person", "runs while clapping, then jumps"),
    ("person", "turns around, walks and sits down"),
    ("dog", "a dog walks, then attacks"),
)
ON_CHARACTERS = ("a person walks forward", "a person waves with the right hand", "a person dances")
GALLERY = (
    "walks forward", "runs", "walks slowly, tired", "walks in a circle", "turns left, then walks on", "walks backwards",
    "sneaks",
    "jumps up high", "hops on one leg", "jumps forward", "does a cartwheel", "does jumping jacks", "does a squat",
    "stretches",
    "kicks with the left leg", "punches", "swings a sword", "is hit and staggers", "falls down dead", "attacks",
    "waves with the right hand", "cheers with both arms up", "claps", "dances", "bows", "sits down on the floor",
    "crawls", "eats something",
    "stands idle", "swims",
)  # fmt: skip
GALLERY_CHARACTERS = (
    "kaykit/Rogue_Hooded", "quaternius/modular_men/King", "quaternius/modular_women/Formal",
    "quaternius2019/Female_Dress",
    "quaternius/animals_pack/ShibaInu", "quaternius/dinosaurs_pack/Velociraptor", "quaternius/cute_fish_pack/Betta",
    "quaternius/easy_enemies_pack/Spider", "quaternius2019/Dragon", "quaternius/platformer_game_pack/Bee",
)  # fmt: skip
"""Of the archive, none of them seen in training."""
GALLERY_TIMES = (0.3, 1.0, 1.7, 2.4, 3.1, 3.8)
FRAMES = 7
SHEET = 40
CHARACTERS: Path | None = None
SUBJECTS: frozenset[str] = frozenset()


def samples() -> None:
    """The sample characters."""
    contact_sheet(
        [render_still(sample_character(name), size=(300, 360)) for name in sample_names()],
        list(sample_names()),
        OUT / "samples.png",
        columns=3,
    )


def handles() -> None:
    """The handles that the predictor finds on forty characters of every category, or on the samples where no archive is
    given.
    """
    chosen = _of_every_category(CHARACTERS, SHEET) if CHARACTERS else []
    if not chosen:
        pictures = [
            render_still(character, rig(character), size=(300, 360))
            for character in map(sample_character, sample_names())
        ]
        contact_sheet(pictures, list(sample_names()), OUT / "handles.png", columns=3)
        return
    pictures, labels = [], []
    for file, category in chosen:
        character = bunraku.load_character(file)
        pictures.append(render_still(character, rig(character), size=(130, 140)))
        labels.append(f"{file.stem} ({category})")
    contact_sheet(pictures, labels, OUT / "handles.png", columns=8)


def _of_every_category(folder: Path, count: int) -> list[tuple[Path, str]]:
    """Files of the archive with their categories: as many of each category as there are, up to an even share, spread
    over its packs.
    """
    with (folder / "index.csv").open(newline="") as file:
        rows = sorted(
            (row["category"], row["path"]) for row in csv.DictReader(file) if (folder / row["path"]).is_file()
        )
    groups: dict[str, list[str]] = {}
    for category, path in rows:
        groups.setdefault(category, []).append(path)
    shares = dict.fromkeys(groups, 0)
    for _ in range(min(count, len(rows))):
        category = min((name for name in groups if shares[name] < len(groups[name])), key=lambda name: shares[name])
        shares[category] += 1
    picked = []
    for category, paths in groups.items():
        picked += [
            (folder / paths[i], category) for i in np.linspace(0, len(paths) - 1, shares[category]).round().astype(int)
        ]
    return picked


def _row(
    character_name: str, prompt: str, seconds: float, seed: int = 0, size: tuple[int, int] = (150, 180)
) -> tuple[list[np.ndarray], list[str]]:
    character = sample_character(character_name)
    animation = animate(character, prompt, seconds=seconds, seed=seed)
    times = np.linspace(0, animation.motion.duration - 1 / animation.motion.fps, FRAMES)
    pictures = list(render_animation(animation, size=size, times=times))
    labels = [f"{time:.1f} s" for time in times]
    labels[0] = prompt
    return pictures, labels


def prompts() -> None:
    """A row of frames for each of twelve sentences, on the person, in two sheets."""
    for sheet, chosen in enumerate((PROMPTS[:6], PROMPTS[6:]), 1):
        pictures, labels = [], []
        for prompt in chosen:
            row, names = _row("person", prompt, 4.0)
            pictures += row
            labels += names
        contact_sheet(pictures, labels, OUT / f"prompts-{sheet}.png", columns=FRAMES)


def gestures() -> None:
    """Each gesture that is made by code at its height, on the person."""
    person = sample_character("person")
    pictures, labels = [], []
    for gesture in all_gestures():
        moments = [time for time, _ in gesture.keys[1:-1]] or [gesture.seconds]
        motion = body_handle_motion(gesture_motion(gesture))
        animation = bunraku.transfer(person, motion)
        pictures += render_animation(animation, size=(150, 180), times=np.array([moments[len(moments) // 2]]))
        labels.append(gesture.name)
    contact_sheet(pictures, labels, OUT / "gestures.png", columns=11)


def stories() -> None:
    """Sentences that say what comes next, and what goes on meanwhile."""
    pictures = [np.concatenate(_row(name, prompt, 6.0, size=(125, 150))[0], axis=1) for name, prompt in STORIES]
    contact_sheet(pictures, [prompt for _, prompt in STORIES], OUT / "stories.png", columns=1)


def characters() -> None:
    """The same sentences on the other sample characters."""
    for prompt in ON_CHARACTERS:
        pictures, labels = [], []
        for name in sample_names():
            if name != "person":
                row, names = _row(name, prompt, 4.0)
                pictures += row
                labels += [name, *names[1:]]
        slug = prompt.removeprefix("a person ").split()[0]
        contact_sheet(pictures, labels, OUT / f"characters-{slug}.png", columns=FRAMES, title=prompt)


def gallery() -> None:
    """Thirty sentences on the sample person and each of ten characters that no training saw, or on the samples where no
    archive is given: a sheet a character.
    """
    chosen: dict[str, Callable[[], Character]] = {
        name: functools.partial(sample_character, name) for name in sample_names()
    }
    if CHARACTERS:
        chosen = {"person": chosen["person"]} | {
            name.rpartition("/")[2]: functools.partial(bunraku.load_character, CHARACTERS / f"{name}.glb")
            for name in GALLERY_CHARACTERS
        }
    for name, load in chosen.items():
        if SUBJECTS and name.lower() not in SUBJECTS:
            continue
        character = load()
        handles = rig(character)
        pictures = []
        for prompt in GALLERY:
            animation = animate(character, prompt, seconds=4.0, seed=1, handles=handles)
            pictures.append(
                np.concatenate(list(render_animation(animation, size=(72, 96), times=GALLERY_TIMES)), axis=1)
            )
        contact_sheet(pictures, list(GALLERY), OUT / f"gallery-{name.lower()}.png", columns=3, title=name)


MAKERS: dict[str, Callable[[], None]] = {
    "samples": samples, "handles": handles, "prompts": prompts, "gestures": gestures, "stories": stories,
    "characters": characters, "gallery": gallery,
}  # fmt: skip


def main() -> None:
    global CHARACTERS, SUBJECTS
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MAKERS))
    parser.add_argument("--characters", type=Path, help="folder of the unpacked character archive, with its index.csv")
    parser.add_argument("--subjects", nargs="+", default=(), help="of the gallery, only these")
    args = parser.parse_args()
    CHARACTERS, SUBJECTS = args.characters, frozenset(name.lower() for name in args.subjects)
    OUT.mkdir(parents=True, exist_ok=True)
    for name in args.names or MAKERS:
        if name not in MAKERS:
            sys.exit(f"there is no picture '{name}'; choose from {', '.join(MAKERS)}")
        print(name, flush=True)
        MAKERS[name]()


if __name__ == "__main__":
    main()
