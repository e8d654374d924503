"""Is generated motion recognised as often as captured motion, by a reader that does not know which is which?

    python benchmarks/blind.py draw POOL -o benchmarks/blind_prompts_3.txt
    python benchmarks/blind.py make benchmarks/blind_prompts_3.txt --pool POOL --data data/motions -o SHEETS --key KEY
    python benchmarks/blind.py score KEY --answers ONE TWO --marks ONE TWO

Each line of a pool is the place that printed a sentence, "owner/name@commit:path:line", a tab and the sentence. `draw`
shuffles the lines by --seed and takes the first that no rule below leaves out; none is chosen by hand. The list that it
writes names the places, each with a digest of the words, which are of others. Commit it before anything is made of it.
`make` takes such a list with its pool, or a file with a sentence a line.

`make` draws captured stretches of held-out clips by lot, one of a clip at the most, and plays all on the reference
body: sentences as `bunraku animate` does with its defaults, stretches as captured, turned so that they begin where
those do. Each motion is a sheet: 20 pictures, evenly spaced, and its way from above. Nothing tells how long it lasts.
Limbs have the colours of their handles: the right leg is blue and green, the left one turquoise and light blue, the
right arm brown and green, the left one violet and red. Sheets are numbered in shuffled order. KEY says what each shows.
KEY-sentences, beside it, has the sentences alone, for the scorer.

Two people describe the sheets and see nothing else: {"1": {"description": "...", "stiff": false}, ...}. A third
gives each description 0, 0.5 or 1, and sees descriptions and sentences alone: {"1": 0.5, ...}. Strict is the share of
marks of 1, half credit the mean mark, each of the generated sheets over that of the captured ones.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import json
import os
import re
from pathlib import Path
from typing import Any

COUNT, CAPTURED, SEED = 40, 20, 20261124
MOST_WORDS = 22
"""Words of the longest watched caption of a captured stretch of the test split."""
SAME = 0.9
"""Likeness of two sentences, letter by letter, from which on they count as one."""
FRAMES, COLUMNS, CELL = 20, 5, (296, 300)
MARKS = (0, 0.5, 1)

COMPANY = r"people|couple|crowd|team|each other|one another|partner|opponent|enemy|friend|customer|students|athletes"
SOMEBODY = r"person|man|woman|boy|girl|child|kid|human|figure|someone|somebody|teenager|grandpa"
THINGS = r"^(an?|the) (\w+ )?(robot|zombie|ball|sphere|object)\b"
UNSEEN = r"fingers?|wink\w*|smil\w*|eyes?|eyebrows?|mouth|lips?|blink\w*|frown\w*"


def letters(sentence: str) -> str:
    return re.sub(r"[^a-z0-9]+", " ", sentence.lower()).strip()


def digest(sentence: str) -> str:
    return hashlib.sha256(letters(sentence).encode()).hexdigest()[:16]


def left_out(sentence: str) -> str:
    """The rule that leaves a sentence out, "" for none."""
    said = letters(sentence)
    if len(said.split()) > MOST_WORDS:
        return f"more than {MOST_WORDS} words"
    if re.search(rf"\b({COMPANY})\b", said) or len(re.findall(rf"\b({SOMEBODY})\b", said)) > 1:
        return "names two people"
    if re.search(THINGS, said):
        return "is about no person"
    if re.search(rf"\b({UNSEEN})\b", said):
        return "names the face or fingers, which no sheet shows"
    return ""


def alike(sentence: str, known: list[str]) -> bool:
    said = letters(sentence)
    return any(difflib.SequenceMatcher(None, said, letters(other)).ratio() >= SAME for other in known)


def read_pool(path: Path) -> dict[str, str]:
    """The sentences of a pool by the places that printed them."""
    return dict(line.split("\t", 1) for line in path.read_text(encoding="utf-8").splitlines())


def read_prompts(path: Path, pool: Path | None) -> list[tuple[str, str]]:
    """Sentences of a list, each with its place, "" in a list of sentences alone."""
    lines = path.read_text(encoding="utf-8").splitlines()
    if not all(re.match(r"[0-9a-f]{16}\t", line) for line in lines):
        return [(line, "") for line in lines]
    if pool is None:
        raise SystemExit(f"{path} names the places of its sentences; name a file that has these and the words (--pool)")
    printed, found = read_pool(pool), []
    for said, place in (line.split("\t") for line in lines):
        if digest(printed.get(place, "")) != said:
            raise SystemExit(f"{pool} has not the sentence of {place} that {path} drew; add it as it is printed there")
        found.append((printed[place], place))
    return found


def draw(args: argparse.Namespace) -> None:
    import numpy as np

    pool = list(read_pool(args.pool).items())
    before = [path for path in args.without if path != args.output]
    known = [line for path in before for line in path.read_text(encoding="utf-8").splitlines()]
    drawn = {line.split("\t")[0] for line in known}
    chosen: list[tuple[str, str]] = []
    reasons: dict[str, int] = {}
    looked = 0
    for number in np.random.default_rng(args.seed).permutation(len(pool)).tolist():
        if len(chosen) == args.count:
            break
        place, sentence = pool[number]
        looked += 1
        used = digest(sentence) in drawn or alike(sentence, known)
        reason = left_out(sentence) or ("is of a list before, or drawn already" if used else "")
        if reason:
            reasons[reason] = reasons.get(reason, 0) + 1
        else:
            chosen.append((place, sentence))
            known.append(sentence)
    lines = [f"{digest(sentence)}\t{place}" for place, sentence in chosen]
    args.output.write_text("\n".join(lines) + "\n", encoding="utf-8")
    for place, sentence in chosen:
        print(f"{sentence}\t{place}")
    print(f"\n{len(chosen)} of {len(pool)} sentences, seed {args.seed}; {looked} looked at; left out: {reasons}")


def make(args: argparse.Namespace) -> None:
    if args.output.resolve() in args.key.resolve().parents:
        raise SystemExit(f"{args.key} would lie among the sheets that {args.output} shows; name a file elsewhere")
    prompts = read_prompts(args.prompts, args.pool)
    os.environ["OMP_NUM_THREADS"] = str(args.threads)  # read when the libraries load, so before any import of them

    import numpy as np

    from bunraku.core.body.reference import reference_body
    from bunraku.errors import OptionError
    from bunraku.language.parse import parse
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.requests import Request

    body = reference_body()
    requests, rows = [], []
    for prompt, place in prompts:
        try:
            sentence, refused = parse(prompt), ""
        except OptionError as error:  # made with --force, as the message says
            sentence, refused = parse(prompt, force=True), str(error)
        requests.append(Request(sentence, handles=body.handles))
        rows.append({"kind": "generated", "sentence": prompt, "from": place, "refused": refused})
    shown = list(Animator.shipped().each(body.character(), requests))
    random = np.random.default_rng(args.seed)
    for row, motion in captured(args.data, args.captured, random):
        rows.append(row)
        shown.append(like(shown[0], motion))
    args.output.mkdir(parents=True, exist_ok=True)
    key = {}
    for number, index in enumerate(random.permutation(len(rows)).tolist(), 1):
        write_sheet(shown[index], args.output / f"{number:02d}.png", number)
        key[number] = rows[index] | {"seconds": len(shown[index].motion) / shown[index].motion.fps}
    args.key.write_text(json.dumps(key, indent=1), encoding="utf-8")
    sentences = args.key.with_name(f"{args.key.stem}-sentences.json")
    sentences.write_text(json.dumps({n: row["sentence"] for n, row in key.items()}, indent=1), encoding="utf-8")
    print(f"{len(rows)} sheets in {args.output}; key: {args.key}; sentences for the scorer: {sentences}")


def captured(folder: Path, count: int, random: Any) -> list[tuple[dict[str, Any], Any]]:
    """Watched stretches of people's clips of the test split, drawn by lot, one of a clip at the most."""
    from bunraku_lab.datasets.motions.clips import load_clip, load_index

    index = load_index(folder)
    held_out = [name for name, entry in index.items() if entry["split"] == "test" and not entry.get("species")]
    stretches = [(name, stretch) for name in sorted(held_out) for stretch in index[name].get("stretches", [])]
    found: dict[str, tuple[dict[str, Any], Any]] = {}
    for number in random.permutation(len(stretches)).tolist():
        name, stretch = stretches[number]
        if name in found or len(found) == count:
            continue
        frames = slice(stretch["start"], stretch["stop"])
        row = {"kind": "captured", "sentence": stretch["texts"][0], "from": f"{name}:{frames.start}-{frames.stop}"}
        found[name] = row, load_clip(folder / f"{name}.npz").take(frames)
    return list(found.values())


def like(animation: Any, motion: Any) -> Any:
    """A captured motion on the body of an animation, begun where the animation's begins. No stage touches it: those
    bring who climbs back to the ground.
    """
    from bunraku.core.animation import Animation
    from bunraku.core.travel import placed_at

    return Animation(animation.character, animation.handles, placed_at(motion, 0, animation.motion, 0))


def write_sheet(animation: Any, path: Path, number: int) -> None:
    import numpy as np

    from bunraku.render.frames import render_animation
    from bunraku.render.pictures import assemble, write_png

    motion = animation.motion
    times = np.linspace(0, (len(motion) - 1) / motion.fps, FRAMES)
    images = list(render_animation(animation, size=CELL, times=times, color="handles"))
    sheet = assemble(images, [str(i + 1) for i in range(FRAMES)], columns=COLUMNS, title=str(number))
    frames = np.round(times * motion.fps).astype(int)
    write_png(np.concatenate([sheet, from_above(motion, frames, sheet.shape[1])]), path)


def from_above(motion: Any, frames: Any, width: int, height: int = 300) -> Any:
    """The way over the ground, which a camera that follows hides: a numbered dot for each picture, and its facing."""
    import numpy as np
    from PIL import Image, ImageDraw, ImageFont

    from bunraku.core.geometry.rotations import heading
    from bunraku.render.stage import view_axes

    right = view_axes()[0][[0, 2]]
    axes = np.stack([right, [-right[1], right[0]]])  # to the right and towards the viewer, over the ground
    angles = heading(motion.root_rotation, motion.fps)[frames]
    places = motion.root_translation[frames][:, [0, 2]] @ axes.T
    faces = np.stack([np.sin(angles), np.cos(angles)], axis=1) @ axes.T
    low, high = places.min(axis=0), places.max(axis=0)
    scale = min(160.0, *(np.array([width - 160, height - 90]) / np.maximum(high - low, 1e-6)))
    at = np.array([width, height + 20]) / 2 + scale * (places - (low + high) / 2)
    ink, grey, red = (58, 64, 72), (190, 196, 202), (200, 60, 40)
    picture = Image.new("RGB", (width, height), (255, 255, 255))
    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(15)
    pen.text((10, 4), "from above, the viewer below; red: where the body faces", ink, font)
    pen.line([(10, 36), (10 + scale, 36)], ink, 3)
    pen.text((16 + scale, 27), "1 m", ink, font)
    pen.line([tuple(point) for point in at.tolist()], grey, 2)
    for i, (point, face) in enumerate(zip(at, faces, strict=True)):
        pen.line([tuple(point), tuple(point + 22 * face)], red, 3)
        pen.ellipse([*(point - 4), *(point + 4)], ink)
        half = i // (FRAMES // 2)  # so that the way back does not hide the way there
        before = at[half * FRAMES // 2 : i]
        if not len(before) or np.linalg.norm(before - point, axis=1).min() > 14:
            pen.text((point[0] + (22 if half else -22), point[1]), str(i + 1), ink, font, anchor="mm")
    return np.asarray(picture)


def score(args: argparse.Namespace) -> None:
    if len(args.answers) != len(args.marks):
        raise SystemExit(f"{len(args.answers)} files of answers need as many of marks, not {len(args.marks)}")
    key = json.loads(args.key.read_text(encoding="utf-8"))
    generated = [number for number, row in key.items() if row["kind"] == "generated"]
    others = [number for number, row in key.items() if row["kind"] == "captured"]
    best = dict.fromkeys(key, 0.0)
    table = ["| | strict | with half credit | over captured | stiff or frozen |", "| --- | --- | --- | --- | --- |"]
    for answers_path, marks_path in zip(args.answers, args.marks, strict=True):
        answers = of_all(answers_path, key)
        marks = of_all(marks_path, key)
        wrong = sorted(number for number in key if marks[number] not in MARKS)
        if wrong:
            raise SystemExit(f"{marks_path} marks {', '.join(wrong)} with something else than 0, 0.5 or 1; correct it")
        best = {number: max(best[number], marks[number]) for number in key}
        strict = [[marks[number] == 1 for number in some] for some in (generated, others)]
        half = [[marks[number] for number in some] for some in (generated, others)]
        stiff = [sum(bool(answers[number].get("stiff")) for number in some) for some in (generated, others)]
        table.append(
            f"| {answers_path.stem} | {counts(strict)} | {counts(half)} | {over(strict)}; {over(half)} "
            f"| {stiff[0]} of {len(generated)}; {stiff[1]} of {len(others)} |"
        )
    print("\n".join(table))
    for kind, some in (("generated", generated), ("captured", others)):
        print(f"\n{kind}, not recognised by any:")
        for number in some:
            if best[number] == 0:
                print(f"- {number}: {key[number]['sentence']}")


def counts(marks: list[list[Any]]) -> str:
    return "; ".join(f"{sum(some):g} of {len(some)}" for some in marks)


def over(marks: list[list[Any]]) -> str:
    """The mean mark of the generated sheets over that of the captured ones."""
    first, second = (sum(some) / len(some) if some else 0.0 for some in marks)
    return f"{first / second:.2f}" if second else "-"


def of_all(path: Path, key: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    missing = sorted(set(key) - set(found), key=int)
    if missing:
        raise SystemExit(f"{path} says nothing of sheet {', '.join(missing)}; add it")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    verb = verbs.add_parser("draw", help="draw sentences by lot")
    verb.add_argument("pool", type=Path)
    verb.add_argument("-o", "--output", type=Path, required=True, help="the list to write")
    verb.add_argument("--count", type=int, default=COUNT)
    verb.add_argument("--seed", type=int, default=SEED)
    lists = sorted(Path(__file__).parent.glob("blind_prompts*.txt"))
    verb.add_argument("--without", type=Path, nargs="*", default=lists, help="lists that were used before")
    verb.set_defaults(run=draw)
    verb = verbs.add_parser("make", help="make the sheets and their key")
    verb.add_argument("prompts", type=Path)
    verb.add_argument("--pool", type=Path, help="the words of a list that names places")
    verb.add_argument("--data", type=Path, default=Path("data/motions"), help="folder of 'bunraku data motions'")
    verb.add_argument("-o", "--output", type=Path, required=True, help="folder of the sheets")
    verb.add_argument("--key", type=Path, required=True, help="file that says what each sheet shows, elsewhere")
    verb.add_argument("--captured", type=int, default=CAPTURED)
    verb.add_argument("--seed", type=int, default=SEED)
    verb.add_argument("--threads", type=int, default=2)
    verb.set_defaults(run=make)
    verb = verbs.add_parser("score", help="the shares that were recognised, generated over captured")
    verb.add_argument("key", type=Path)
    verb.add_argument("--answers", type=Path, nargs="+", required=True, help="a file of each describer")
    verb.add_argument("--marks", type=Path, nargs="+", required=True, help="the marks of each, in the same order")
    verb.set_defaults(run=score)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
