"""How well is a sentence from outside read? A Markdown table over the labels of `reader_300.md`.

    python benchmarks/reader.py [rules|second|MODULE:FUNCTION] [--strict] [--errors]

A reader takes a sentence and gives its frames: a list of dicts, one a clause, with `action` and, where the sentence
says so, `direction`, `turn`, `posture` and `count` as `reader_300.md` has them. No frames, or the action "none", is
"nothing I know". `rules` is the parser, `second` the second labelling of a third of the sentences, which is then scored
on that third alone.

Columns. exact: all named clauses found and nothing else said, of the sentences that name an action. F1: of actions,
micro-averaged over sentences. something: at least one clause found. order: found clauses come in the order of the
labels, of the sentences that are exact and have several. silent: nothing said, of the sentences in which no action is
named that the lexicon has. direction, turn, posture, count: the values of all clauses are the right ones, once over all
sentences and once over those that have a value. An action counts if the label has it as `action` or in `also`; with
--strict, only as `action`. Nothing is to be tuned on these sentences.
"""

from __future__ import annotations

import argparse
import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

Frames = list[dict[str, Any]]

FOLDER = Path(__file__).parent
FIELDS = ("direction", "turn", "posture", "count")
PROMPT_LISTS = {"MBench", "Motion-X", "SINC", "FlowMDM", "BABEL", "SnapMoGen", "demo prompts"}
"""The lists of text-to-motion projects; all others are clip names and descriptions of game makers."""
GOES_FORWARD = {"walk", "run", "march", "sneak", "limp", "zombie", "crawl", "crouch walk", "skip", "swim"}
"""Actions that travel forward without saying so: "forward" is left out of the comparison."""
POSTURES = {
    "sit": "sitting", "cross legs": "sitting", "cycle": "sitting", "kneel": "kneeling", "both knees": "kneeling",
    "propose": "kneeling", "lie": "lying", "fall": "lying", "sit-up": "lying", "squat": "crouching",
    "crawl": "all fours", "push-up": "all fours", "hang": "hanging",
}  # fmt: skip
"""Postures that the parser's actions bring with them."""
TURNS = {"turn": "?", "turn around": "180", "spin": "360"}
"""How far actions turn that are nothing else [degrees]."""
STANCES = {
    "chair": "sitting", "seat": "sitting", "floor": "sitting", "crossed": "sitting", "kneel": "kneeling",
    "both knees": "kneeling", "squat": "crouching", "back": "lying", "belly": "lying",
}  # fmt: skip


def labels(name: str) -> dict[str, Frames]:
    lines = (FOLDER / name).read_text(encoding="utf-8").splitlines()
    return {row["id"]: row["clauses"] for row in map(json.loads, lines)}


def rules(sentence: str) -> Frames:
    """The parser's clauses as frames."""
    from bunraku.errors import OptionError
    from bunraku.language.parse import parse

    try:
        clauses = parse(sentence).clauses
    except OptionError:
        return []
    single = [part for clause in clauses for part in (clause.parts or (clause,))]
    return [frame for clause in single for frame in _frames_of(clause)]


def _frames_of(clause: Any) -> Frames:
    from bunraku.language.posing import Posing

    posing = clause.detail if isinstance(clause.detail, Posing) else None
    stance = clause.stance or (posing.stance if posing else None)
    side = "left" if "left go" in clause.cues else "right" if "right go" in clause.cues else ""
    along = "backward" if "backwards" in clause.cues else "forward" if "forward" in clause.cues else ""
    if posing and not side and not along:
        ways = {way for target in posing.targets for way in target.ways}
        along = "backward" if "back" in ways else "forward" if "forward" in ways else "down" if "down" in ways else ""
    frames: Frames = []
    read = [(frame.action, frame.fields) for frame in clause.frames] or [("none", {})]
    for action, fields in read:
        frame: dict[str, Any] = {"action": action}
        direction = "circle" if action == "circle" else "-".join(filter(None, (along, side)))
        direction = fields.get("direction", "") or direction
        if direction:
            frame["direction"] = direction
        if action in TURNS or "turn side" in fields:
            frame["turn"] = f"{fields.get('degrees', TURNS.get(action, '?'))} {fields.get('turn side', '?')}"
        posture = POSTURES.get(action) or (STANCES.get(stance.name) if stance else None)
        posture = (
            fields.get("posture")
            or posture
            or ("sitting" if "sits" in clause.traits else "lying" if "lies" in clause.cues else None)
        )
        if posture:
            frame["posture"] = posture
        if clause.count is not None:
            frame["count"] = clause.count
        frames.append(frame)
    return frames


def names_of(clause: dict[str, Any], strict: bool) -> set[str]:
    """The names that a clause of the labels accepts, without "none"."""
    return ({clause["action"]} | (set() if strict else set(clause.get("also", ())))) - {"none"}


def values_of(frames: Frames, field: str) -> set[Any]:
    found = {frame[field] for frame in frames if frame.get(field) is not None}
    if field == "direction":
        unsaid = [frame.get("direction") for frame in frames if frame["action"] in GOES_FORWARD]
        found -= {"forward"} if "forward" in unsaid else set()
    return found


def same(field: str, meant: Frames, said: Frames) -> bool:
    one, other = values_of(meant, field), values_of(said, field)
    if field != "turn":
        return one == other
    sides = {turn.split()[1] for turn in one} == {turn.split()[1] for turn in other}
    degrees = {turn.split()[0] for turn in one} - {"?"}
    return sides and degrees <= {turn.split()[0] for turn in other}


def score(meant: dict[str, Frames], said: dict[str, Frames], known: set[str], strict: bool) -> tuple[list[str], list]:
    """A row of the table, and the ids whose actions are not exact."""
    exact, something, order, silent, wrong = [], [], [], [], []
    found = expected = right = given = 0
    fields: dict[str, list[tuple[bool, bool]]] = {field: [] for field in FIELDS}
    for key, clauses in meant.items():
        frames = said.get(key, [])
        actions = list(dict.fromkeys(frame["action"] for frame in frames if frame["action"] != "none"))
        named = {clause["action"]: names_of(clause, strict) for clause in clauses if clause["action"] != "none"}
        spare = {name for clause in clauses if clause["action"] == "none" for name in names_of(clause, strict)}
        accepted = set().union(*named.values()) if named else set()
        hits = [action for action, names in named.items() if names & set(actions)]
        extra = [action for action in actions if action not in accepted | spare]
        found, expected = found + len(hits), expected + len(named)
        right, given = right + sum(action in accepted for action in actions), given + len(set(actions) - spare)
        if named:
            exact.append(len(hits) == len(named) and not extra)
            something.append(bool(hits))
            places = [min(actions.index(one) for one in names if one in actions) for names in named.values()
                      if names & set(actions)]  # fmt: skip
            if exact[-1] and len(named) > 1:
                order.append(places == sorted(places))
        if not (accepted & known):
            silent.append(not extra)
        if (named and not exact[-1]) or (not named and extra):
            wrong.append(key)
        for field in FIELDS:
            fields[field].append((same(field, clauses, frames), bool(values_of(clauses, field))))
    precision, recall = right / max(given, 1), found / max(expected, 1)
    row = [share(exact), f"{2 * precision * recall / max(precision + recall, 1e-9):.2f}", share(something)]
    row += [share(order), share(silent)]
    for pairs in fields.values():
        row.append(f"{share([one for one, _ in pairs])}, {share([one for one, has in pairs if has])}")
    return [str(len(meant)), *row], wrong


def share(values: list[bool]) -> str:
    return f"{sum(values) / len(values):.2f} ({len(values)})" if values else "-"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reader", nargs="?", default="rules")
    parser.add_argument("--strict", action="store_true", help="count only `action`, not `also`")
    parser.add_argument("--errors", action="store_true", help="print the sentences whose actions are not exact")
    args = parser.parse_args()

    from bunraku.language.lexicon import lexicon

    known = set(lexicon().actions)
    meant = labels("reader_300.labels.jsonl")
    rows = [line.split("\t") for line in (FOLDER / "reader_300.tsv").read_text(encoding="utf-8").splitlines()]
    sentences = {key: text for key, _, text in rows}
    if args.reader == "second":
        said = labels("reader_300.second.jsonl")
        meant = {key: clauses for key, clauses in meant.items() if key in said}
    else:
        module, _, name = args.reader.partition(":")
        reader: Callable[[str], Frames] = rules if not name else getattr(importlib.import_module(module), name)
        said = {key: reader(sentences[key]) for key in meant}
    games = {key for key, name, _ in rows if name not in PROMPT_LISTS}
    within = {key for key, clauses in meant.items() if any(names_of(clause, False) for clause in clauses) and all(
        names_of(clause, False) & known or clause["action"] == "none" for clause in clauses)}  # fmt: skip
    groups = {"all": set(meant), "the lexicon has its actions": within, "clips": games, "prompts": set(meant) - games}
    print("| sentences | number | exact | F1 | something | order | silent | direction | turn | posture | count |")
    print("| --- |" + " --- |" * 10)
    for name, keys in groups.items():
        row, wrong = score({key: meant[key] for key in meant if key in keys}, said, known, args.strict)
        print(f"| {name} | {' | '.join(row)} |")
        if args.errors and name == "all":
            lines = [(key, [clause["action"] for clause in meant[key]], [one["action"] for one in said.get(key, [])])
                     for key in wrong]  # fmt: skip
    for key, one, other in lines if args.errors else ():
        print(f"{key}\t{sentences[key]}\t{one}\t{other}")


if __name__ == "__main__":
    main()
