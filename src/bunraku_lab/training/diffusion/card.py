"""The card of a training run's weights: what they learned from, on which terms, and whom to name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from bunraku.errors import WeightsError
from bunraku.formats.files import atomic_write
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku_lab.datasets.motions.sources import credit_lines
from bunraku_lab.training.diffusion.config import SHIPPED, TrainingConfig
from bunraku_lab.training.rows.clip_data import ClipEntry

__all__ = ["training_card", "write_card"]

_CREDITS = "## Credits"


def training_card(clips: Mapping[str, ClipEntry], config: TrainingConfig) -> str:
    """A model card in Markdown.

    The terms of the weights that a run starts from hold for what comes out of it, so their credits are carried on.

    Args:
        clips: All clips of the data, those that are held out too.
        config: The run.
    """
    learned = {name: entry for name, entry in clips.items() if entry.get("split", "train") == "train"}
    seconds: Counter[str] = Counter()
    for entry in learned.values():
        seconds[entry.get("licence") or "unknown"] += len(entry["features"]) / 20  # type: ignore[assignment]
    lines = [
        "# Model card",
        "",
        "The Shape-aware Motion Diffusion (section 3.2 of TapMo), trained with `bunraku train diffusion` on "
        f"{len(learned)} clips, {sum(seconds.values()) / 60:.1f} minutes.",
        "",
        "| licence of the clips | minutes |",
        "| --- | ---: |",
        *(f"| {licence} | {value / 60:.1f} |" for licence, value in seconds.most_common()),
        "",
    ]
    if config.start is not None:
        lines += [f"It went on from {config.start.name}, whose terms hold for it too.", ""]
    if config.rehearse:
        lines += [f"Of people's rows {config.rehearse:.0%} were captured examples that Bunraku brings.", ""]
    own = [f"{entry['credit']}. Licence: {entry['licence']}." for entry in learned.values() if entry.get("credit")]
    credits = list(dict.fromkeys([*credit_lines(learned), *own, *_carried(config)]))
    if credits:
        lines += [_CREDITS, "", *(f"- {line}" for line in credits), ""]
    return "\n".join(lines)


def _carried(config: TrainingConfig) -> list[str]:
    """The credits of the weights that the run starts from, and of the examples that it rehearses, where their cards are
    beside them.
    """
    names = ["diffusion"] if config.start == SHIPPED else []
    names += ["examples"] if config.rehearse else []
    cards = [] if config.start in (None, SHIPPED) else [config.start.with_suffix(".md")]  # type: ignore[union-attr]
    for name in names:
        try:
            cards.append(shipped_checkpoint(name).with_suffix(".md"))
        except WeightsError:
            continue
    found = []
    for card in cards:
        if card.is_file():
            text = card.read_text(encoding="utf-8", errors="replace").partition(_CREDITS)[2]
            found += [line[2:].strip() for line in text.splitlines() if line.startswith("- ")]
    return found


def write_card(weights: Path, card: str) -> Path:
    """Write a card beside weights."""
    path = weights.with_suffix(".md")
    with atomic_write(path) as file:
        file.write(card.encode())
    return path
