"""The verbs of the laboratory: `bunraku data`, `bunraku train` and `bunraku evaluate`.

The entry point "bunraku.verbs" tells the command line of them, so that nothing of `bunraku` imports this package.
"""

from __future__ import annotations

__all__ = ["VERBS"]

# Words -> module, its attribute that is the verb, one line of help.
VERBS: dict[tuple[str, ...], tuple[str, str, str]] = {
    ("data", "motions"): ("bunraku_lab.cli.data", "Motions", "turn a motion archive into handle motions to train on"),
    ("data", "characters"): ("bunraku_lab.cli.data", "Characters", "turn rigged characters into samples to train on"),
    ("data", "mesh-bank"): ("bunraku_lab.cli.data", "MeshBank", "write the mesh features of characters to train with"),
    ("data", "character-bank"): (
        "bunraku_lab.cli.data",
        "CharacterBank",
        "pack rigged characters for the losses of mesh-specific motion learning",
    ),
    ("data", "bundle"): (
        "bunraku_lab.cli.data",
        "DataBundle",
        "pack the motion data into one file, to train with on another machine",
    ),
    ("data", "examples"): (
        "bunraku_lab.cli.data",
        "Examples",
        "pack captured stretches that generated motion may start from",
    ),
    ("data", "wardrobe"): (
        "bunraku_lab.cli.data_apparel",
        "Wardrobe",
        "make dressed characters with rigid bodies for their apparel, as PMX files",
    ),
    ("data", "apparel"): (
        "bunraku_lab.cli.data_apparel",
        "Apparel",
        "simulate the apparel of characters in motion, as data to train on",
    ),
    ("train", "handles"): ("bunraku_lab.cli.train", "handles", "train the Mesh Handle Predictor"),
    ("train", "orientation"): (
        "bunraku_lab.cli.train",
        "orientation",
        "train the network that knows how a character stands",
    ),
    ("train", "diffusion"): ("bunraku_lab.cli.train", "diffusion", "train the Shape-aware Motion Diffusion"),
    ("train", "extractor"): (
        "bunraku_lab.cli.train",
        "extractor",
        "train the feature extractor that generated motion is measured with",
    ),
    ("train", "ranker"): ("bunraku_lab.cli.train", "ranker", "train the ranker that chooses among candidates"),
    ("train", "tagger"): ("bunraku_lab.cli.train", "tagger", "train the tagger that reads words of other languages"),
    ("train", "apparel-mask"): (
        "bunraku_lab.cli.train",
        "apparel_mask",
        "train the network that finds apparel on a mesh",
    ),
    ("train", "apparel-body"): (
        "bunraku_lab.cli.train",
        "apparel_body",
        "train skinning weights by geodesic attention",
    ),
    ("train", "apparel-refinement"): (
        "bunraku_lab.cli.train",
        "apparel_refinement",
        "train what merges body and apparel",
    ),
    ("train", "apparel"): ("bunraku_lab.cli.train", "apparel", "train the network that moves apparel"),
    ("train", "few-steps"): ("bunraku_lab.cli.train", "few_steps", "distil the denoiser into four steps"),
    ("train", "nbs"): ("bunraku_lab.cli.train", "nbs", "train Neural Blend Shapes, a baseline of the papers' tables"),
    ("train", "transfer-baseline"): (
        "bunraku_lab.cli.train",
        "transfer_baseline",
        "train Skeleton-free Pose Transfer, a baseline of the papers' tables",
    ),
    ("train", "adaptation"): ("bunraku_lab.cli.train", "adaptation", "fine-tune the adaptation of motions to meshes"),
    ("evaluate", "handles"): (
        "bunraku_lab.cli.evaluate_characters",
        "EvaluateHandles",
        "measure the handles on rigged characters",
    ),
    ("evaluate", "blocks"): (
        "bunraku_lab.cli.evaluate_characters",
        "EvaluateBlocks",
        "measure whether figures of rigid blocks stay rigid and jointed",
    ),
    ("evaluate", "motion"): (
        "bunraku_lab.cli.evaluate_motion",
        "EvaluateMotion",
        "measure generated motion on held-out clips",
    ),
    ("evaluate", "transfer"): (
        "bunraku_lab.cli.evaluate_characters",
        "EvaluateTransfer",
        "measure motion transfer on rigged characters",
    ),
    ("evaluate", "physics"): (
        "bunraku_lab.cli.evaluate_characters",
        "EvaluatePhysics",
        "measure the simulated apparel of MMD and VRM characters",
    ),
    ("evaluate", "tables"): (
        "bunraku_lab.cli.evaluate_motion",
        "EvaluateTables",
        "measure the papers' tables, theirs and ours side by side",
    ),
    ("evaluate", "apparel"): (
        "bunraku_lab.cli.evaluate_characters",
        "EvaluateApparel",
        "measure learned apparel on characters and motions that it has not seen",
    ),
}
