"""The verbs of the laboratory: `bunraku data`, `bunraku train` and `bunraku evaluate`.

The command line finds them by the entry point "bunraku.verbs", so nothing of `bunraku` imports this package.
"""

from __future__ import annotations

from bunraku_lab.cli.train import TRAININGS

# Words, module, class, one line of help.
_CLASSES = (
    ("data motions", "data", "Motions", "turn a motion archive into handle motions to train on"),
    ("data characters", "data", "Characters", "turn rigged characters into samples to train on"),
    ("data mesh-bank", "data", "MeshBank", "write the mesh features of characters to train with"),
    ("data character-bank", "data", "CharacterBank", "pack rigged characters for mesh-specific motion learning"),
    ("data bundle", "data", "DataBundle", "pack the motion data into one file, to train with on another machine"),
    ("data examples", "data", "Examples", "pack captured stretches that generated motion may start from"),
    ("data wardrobe", "data_apparel", "Wardrobe", "make dressed characters with rigid bodies, as PMX files"),
    ("data apparel", "data_apparel", "Apparel", "simulate the apparel of characters in motion, as data to train on"),
    ("evaluate handles", "evaluate_characters", "EvaluateHandles", "measure the handles on rigged characters"),
    ("evaluate motion", "evaluate_motion", "EvaluateMotion", "measure generated motion on held-out clips"),
    ("evaluate transfer", "evaluate_characters", "EvaluateTransfer", "measure motion transfer on rigged characters"),
    ("evaluate physics", "evaluate_characters", "EvaluatePhysics", "measure the simulated apparel of characters"),
    (
        "evaluate tables",
        "evaluate_motion",
        "EvaluateTables",
        "measure the papers' tables beside ours",
    ),
    ("evaluate apparel", "evaluate_characters", "EvaluateApparel", "measure learned apparel on unseen characters"),
)

VERBS: dict[tuple[str, ...], tuple[str, str, str]] = {
    tuple(words.split()): (f"bunraku_lab.cli.{module}", name, summary) for words, module, name, summary in _CLASSES
} | {
    ("train", name): ("bunraku_lab.cli.train", name, "train " + training.network.split(" (")[0].split(",")[0])
    for name, training in TRAININGS.items()
}
"""Words -> module, its attribute that is the verb, one line of help."""
