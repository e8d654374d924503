"""Are sentences in other languages read as their English is? Two Markdown tables.

    python benchmarks/languages.py [--pairs runs/languages --likeness runs/tagger/likeness.json] [--without-tagger]

The first: captions of `languages.json`. Forty were drawn by lot (`random.Random(31).sample`) from the 80 of
`blind_prompts.txt` and `blind_prompts_2.txt`, and translated before anything was measured on them. Columns: the share
with exactly the actions of the English sentence, with its sides, with its actions in the same order, with all three;
and the share that is understood at all.

The second, where pairs are given: of those that training holds out, 200 a language drawn by lot in which the English
says a movement as captions do, and 200 in which it says none. Columns: F1 of the actions that are found and the share
with exactly the right ones, against what is meant and against all that the rules find in the English; and the share of
sentences without a movement in which one is read.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from bunraku.language import foreign_tagger
from bunraku.language.lexicon import actions_of
from bunraku.language.parse import parse
from bunraku.language.understood import understood
from bunraku.language.word_table import LANGUAGES

SENTENCES = 200


def said(sentence: str) -> tuple[frozenset[str], frozenset[str], tuple[str, ...]]:
    """Actions, sides, and actions in their order."""
    clauses = parse(sentence, force=True).clauses
    order = tuple(action for clause in clauses for action in clause.actions)
    sides = {cue for clause in clauses for cue in clause.cues if cue.startswith(("left ", "right "))}
    return frozenset(order), frozenset(sides), order


def captions() -> None:
    """The first table."""
    rows = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))
    columns = ("actions", "sides", "order", "all three", "understood")
    print(f"| | {' | '.join(columns)} |\n| --- |{' --- |' * len(columns)}")
    for language, name in LANGUAGES.items():
        right = []
        for row in rows:
            same = [one == other for one, other in zip(said(row["en"]), said(row[language]), strict=True)]
            right.append([*same, all(same), understood(row[language]).ok])
        shares = [f"{sum(column) / len(rows):.3f}" for column in zip(*right, strict=True)]
        print(f"| {name} | {' | '.join(shares)} |")


def read(sentence: str) -> frozenset[str]:
    """The actions that a user who gives a sentence gets."""
    found = understood(sentence)
    return frozenset(actions_of(found.english)) if found.ok else frozenset()


def pairs(folder: Path, measured: Path, split: str) -> None:
    """The second table."""
    from bunraku_lab.training.language import MEANT, NOT_MEANT, drawn_number, likeness_of, read_pairs

    like = likeness_of(json.loads(measured.read_text(encoding="utf-8")))
    print("\n| | F1 of what is meant | exactly | F1 of all that the rules find | exactly | said of none |")
    print("| --- | --- | --- | --- | --- | --- |")
    found = sorted(read_pairs(folder, [split]), key=lambda pair: drawn_number(pair.other, "measure"))
    for language, name in LANGUAGES.items():
        meant: list[tuple[frozenset[str], frozenset[str]]] = []
        ruled: list[tuple[frozenset[str], frozenset[str]]] = []
        silent: list[bool] = []
        for pair in found:
            if pair.language != language:
                continue
            cosines = like(pair.english) if pair.actions else {}
            yes = frozenset(action for action in pair.actions if cosines.get(action, 0.0) >= MEANT)
            maybe = frozenset(action for action in pair.actions if cosines.get(action, NOT_MEANT) >= NOT_MEANT) - yes
            if pair.actions and len(ruled) < SENTENCES:
                ruled.append((frozenset(pair.actions), read(pair.other)))
            if yes and len(meant) < SENTENCES:
                meant.append((yes, read(pair.other) - maybe))
            elif not yes and not maybe and len(silent) < SENTENCES:
                silent.append(bool(read(pair.other)))
        figures = [figure for rows in (meant, ruled) for figure in scores(rows)] + [sum(silent) / len(silent)]
        print(f"| {name} | {' | '.join(f'{figure:.3f}' for figure in figures)} |")


def scores(rows: list[tuple[frozenset[str], frozenset[str]]]) -> tuple[float, float]:
    """F1, and the share of sentences with exactly the right actions."""
    right = sum(len(one & other) for one, other in rows)
    exactly = sum(one == other for one, other in rows) / len(rows)
    return 2 * right / max(sum(len(one) + len(other) for one, other in rows), 1), exactly


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=Path)
    parser.add_argument("--likeness", type=Path, default=Path("runs/tagger/likeness.json"))
    parser.add_argument("--split", default="held", help="held, or val, which sets the bar from which it is sure")
    parser.add_argument("--sure", type=float, default=foreign_tagger.SURE)
    parser.add_argument("--without-tagger", action="store_true")
    args = parser.parse_args()
    foreign_tagger.SURE = 2.0 if args.without_tagger else args.sure
    if args.split == "held":
        captions()
    if args.pairs is not None:
        pairs(args.pairs, args.likeness, args.split)


if __name__ == "__main__":
    main()
