"""Fingerprints of what `animate` and `transfer` make, to hold two versions of the code against each other.

    python benchmarks/same_bytes.py -o before.json          # on one version
    python benchmarks/same_bytes.py --against before.json   # on another, with the same weights

Twenty sentences on six characters, six transfers, and the dancer with her apparel moved in three ways, each with a seed
of its own: the hash of all posed vertices. The processor and the version of torch must be the same; the last bits
depend on both.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bunraku
from bunraku.core.animation import AnimatedCharacter

CHARACTERS = ("person", "dancer", "dog", "dragon", "mushroom", "robot")
SENTENCES = (
    "a person walks forward",
    "walks forward, then waves with the left hand",
    "runs while clapping",
    "walks:4; jumps:2; waves:3",
    "turns left and sits down",
    "a man kicks with his right leg",
    "jumps up and down three times",
    "walks backwards slowly",
    "someone picks something up and throws it",
    "dances happily",
    "crawls on hands and knees",
    "walks in a circle to the right",
    "stands still and looks around",
    "sneaks forward and hides",
    "salutes, then marches on",
    "talks on the phone while walking",
    "does jumping jacks",
    "boxes like a fighter",
    "ein Mann läuft und winkt",
    "falls down and stands up again",
)
MOTIONS = ("walks forward and turns right", "waves with both hands")


def made() -> Iterator[tuple[str, AnimatedCharacter]]:
    """Name and animation of each case."""
    with tempfile.TemporaryDirectory() as folder:
        characters = {name: bunraku.sample_character(name) for name in CHARACTERS}
        for number, prompt in enumerate(SENTENCES):
            for name, character in characters.items():
                try:
                    yield f"{name}: {prompt}", bunraku.animate(character, prompt, seconds=3, seed=number)
                except bunraku.BunrakuError as error:
                    print(f"{name}: {prompt}: {error}", file=sys.stderr)
        for number, prompt in enumerate(MOTIONS):
            path = Path(folder) / f"{number}.bvh"
            bunraku.animate(characters["person"], prompt, seconds=3, seed=number).save(path)
            motion = bunraku.load_motion(path)
            for name in ("dancer", "robot", "mushroom"):
                yield f"{name}: transfer of {prompt}", bunraku.transfer(characters[name], motion)
        for number, apparel in enumerate(("auto", "chains", "learn")):
            moved = bunraku.animate(characters["dancer"], SENTENCES[0], seconds=3, seed=number, apparel=apparel)
            yield f"dancer: apparel {apparel}", moved


def main() -> int:
    """Print or compare the fingerprints; the exit status is 1 where they differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, help="write the fingerprints here")
    parser.add_argument("--against", type=Path, help="fingerprints of the other version")
    arguments = parser.parse_args()
    found = {}
    for name, animation in made():
        vertices = animation.vertices()
        found[name] = hashlib.sha256(vertices.tobytes()).hexdigest()[:16]
        print(found[name], name, flush=True)
    if arguments.output:
        arguments.output.write_text(json.dumps(found, indent=1), encoding="utf-8")
    if arguments.against is None:
        return 0
    other = json.loads(arguments.against.read_text(encoding="utf-8"))
    differs = sorted(name for name in found.keys() | other.keys() if found.get(name) != other.get(name))
    print(f"{len(found) - len(differs)} of {len(found)} are the same", *differs, sep="\n  ")
    return bool(differs)


if __name__ == "__main__":
    sys.exit(main())
