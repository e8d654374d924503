"""Write `src/bunraku/language/vocabulary.json`: the words that two or more of the watched captions share, and the verbs
that captions begin with.

    python tools/build_vocabulary.py runs/data/source/captions_watched.json

With `--held-out` it writes nothing, but tells how much of one half of the clips is understood with the words of the
other half.
"""

from __future__ import annotations

import argparse
import json
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

OUT = Path(__file__).resolve().parents[1] / "src" / "bunraku" / "language" / "vocabulary.json"
LEAST = 2
"""Sentences that must have a word: what one alone has may be a slip."""
_WORD = re.compile(r"[a-z]+(?:['-][a-z]+)*")
_SAYS = re.compile(r"(?:^(?:(?:a|the|one) (?:person|human|man|woman|figure|character)|someone|somebody)|then) (\w+s)\b")
"""A verb after its subject, or after "then"."""
_LINK = re.compile(r"(?:,? and then |,? then |,? and |, )")


def captions(path: Path) -> list[list[list[str]]]:
    """The sentences of each stretch of each clip, the tersest last."""
    clips = json.loads(path.read_text(encoding="utf-8"))["clips"]
    return [[stretch["texts"] for stretch in clips[name]] for name in sorted(clips)]


def vocabulary(clips: Iterable[list[list[str]]]) -> dict[str, object]:
    """Words with the number of sentences that have them, and the verbs that sentences begin with, as they are written:
    the tersest, which are orders ("climb up", "turn left and walk"), and the others after their subject.
    """
    words: Counter[str] = Counter()
    seen: set[str] = set()
    verbs: Counter[str] = Counter()
    for stretch in (texts for clip in clips for texts in clip):
        for sentence in {text.lower() for text in stretch} - seen:
            seen.add(sentence)
            words.update(set(_WORD.findall(sentence)))
    third = {word.removesuffix("s") for word in words if word.endswith("s")}
    gerunds = {word.removesuffix("ing") for word in words if word.endswith("ing")}
    for texts in (texts for clip in clips for texts in clip):
        for part in _LINK.split(texts[-1].lower()):
            first = _WORD.match(part)
            if first and first.group() in third and {first.group(), first.group().removesuffix("e")} & gerunds:
                verbs[first.group()] += 1
        for text in texts[:-1]:
            verbs.update(_SAYS.findall(text.lower()))
    return {
        "words": {word: count for word, count in sorted(words.items()) if count >= LEAST},
        "verbs": sorted(word for word, count in verbs.items() if count >= LEAST),
    }


def main() -> None:
    """Build, or measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captions", type=Path)
    parser.add_argument("--held-out", action="store_true")
    args = parser.parse_args()
    clips = captions(args.captions)
    if not args.held_out:
        OUT.write_text(json.dumps(vocabulary(clips), separators=(",", ":")) + "\n", encoding="utf-8")
        print(f"{OUT}: {OUT.stat().st_size / 1000:.1f} kB")
        return
    from bunraku.language import vocabulary as known

    half = vocabulary(clips[::2])
    known._written = lambda: half
    from bunraku.language.understood import understood

    sentences = sorted({text for clip in clips[1::2] for texts in clip for text in texts})
    refused = [text for text in sentences if not understood(text).ok]
    partly = sum(bool(understood(text).unknown) for text in sentences)
    print(f"{len(sentences)} sentences of the other half: {len(refused)} refused, {partly} with an unknown word")
    print("\n".join(refused))


if __name__ == "__main__":
    main()
