"""Handle-FID of the rows of TapMo's table 2: how near the shape of a moving body comes to that of real motion, on a
tall and a small body (section 4.1).

Each row moves the mesh of both bodies after the sentences of held-out windows. Since not every method has handles, they
are read off the vertices, as means by the body's own weights; the real motions of the same windows are read likewise.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.from_handles import skeleton_from_handles
from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import ReferenceBody, reference_body
from bunraku.core.animation import Animation
from bunraku.core.motion import HandleMotion
from bunraku.diffusion.features import decode
from bunraku.errors import CharacterError
from bunraku.geometry.registration import part_means
from bunraku.geometry.rotations import matrix_y
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.baselines.skeletal_retarget import copied_motion, rig_by_embedding
from bunraku_lab.baselines.transfer_target import source_motion
from bunraku_lab.evaluation.motion.handle_fid import BODIES, EVERY
from bunraku_lab.evaluation.motion.metrics import fid
from bunraku_lab.evaluation.motion.samples import Request, SamplerSettings, checkpoint_digest, make_motions
from bunraku_lab.evaluation.motion.windows import Window, draw_windows, window_features
from bunraku_lab.evaluation.parts import Parts, at_once
from bunraku_lab.evaluation.tables.distortion import (
    NO_STAGES,
    DistortionConfig,
    adapted_weights,
    transferred_motion,
    transfers_of,
)
from bunraku_lab.nn.baselines.pose_transfer import TransferNetwork
from bunraku_lab.training.rows.clip_data import load_clips, people

__all__ = ["body_samples", "measure_handles"]

LEFT, RIGHT = HANDLE_NAMES.index("left_hip"), HANDLE_NAMES.index("right_hip")
Motions = Sequence[HandleMotion]


def body_samples(vertices: np.ndarray, body: ReferenceBody) -> np.ndarray:
    """Where the handles that a body has are as it moves, seen from below the root with the hips to the sides, over its
    height, shape (N, 3 K).

    Args:
        vertices: In N frames [m], shape (N, V, 3).
        body: Whose mesh moves.
    """
    points = np.stack([part_means(frame, body.handle_weights) for frame in vertices])
    across = points[:, LEFT] - points[:, RIGHT]
    points = points - points[:, :1] * [1, 0, 1]
    ahead = np.einsum("nij,nkj->nki", matrix_y(np.arctan2(across[:, 2], across[:, 0])), points)
    own = ahead[:, body.handle_weights.sum(axis=0) > 0]
    return np.asarray(own.reshape(len(points), -1) / np.ptp(body.vertices[:, 1]))


def measure_handles(
    config: DistortionConfig, data: Path, count: int, progress: Callable[[str, float], None] | None = None,
    parts: Parts = at_once,
) -> dict[str, float]:  # fmt: skip
    """Handle-FID of each row, mean over both bodies; a row that cannot move one of them is left out.

    Args:
        config: The networks.
        data: Folder that `bunraku data motions` wrote.
        count: Windows.
        progress: Called with a stage's name and the share done.
        parts: Measures each row on each body, or knows what was measured of it before.

    Raises:
        FormatError: The data are missing or damaged.
    """
    report = progress or (lambda stage, done: None)
    clips = people(load_clips(data, splits={"test"}), "test")
    windows = draw_windows(clips, count, np.random.default_rng([config.seed, 21]))
    mark = hashlib.sha256(" ".join(f"{one.clip} {one.sentence} {one.frames}" for one in windows).encode()).hexdigest()

    @cache
    def truth(shape: str) -> np.ndarray:
        return _fitted([decode(window_features(clips, window)) for window in windows], shape, Stages())

    found: dict[str, list[float | None]] = {}
    for number, shape in enumerate(BODIES):
        report("handles of bodies", number / len(BODIES))
        for row, digest, samples in _rows(config, windows, shape):

            def against(samples: Callable[[], np.ndarray] = samples, shape: str = shape) -> float | None:
                try:
                    return float(fid(samples(), truth(shape)))
                except CharacterError:
                    return None

            found.setdefault(row, []).append(parts(f"handles {shape} {row} {digest} {mark[:16]}", against))
    report("handles of bodies", 1.0)
    known = {row: [value for value in values if value is not None] for row, values in found.items()}
    return {row: float(np.mean(values)) for row, values in known.items() if len(values) == len(BODIES)}


def _rows(
    config: DistortionConfig, windows: Sequence[Window], shape: str
) -> Iterator[tuple[str, str, Callable[[], np.ndarray]]]:
    """Each row on a body: its name, what tells its weights from others, and what makes its samples."""
    own = config.checkpoint or shipped_checkpoint("diffusion")
    theirs = partial(_drawn, config, own, windows, None)
    ours = checkpoint_digest(own)
    for row, stages in (("ours", Stages(shape=True)), ("ours, without adaptation", Stages(shape=False))):
        yield row, ours, partial(_ours, config, own, windows, shape, stages)
    for row, adapter in config.adapters.items():
        path = adapted_weights(config, row, adapter)
        yield row, checkpoint_digest(path), partial(_ours, config, path, windows, shape, Stages(shape=False))
    yield "MDM-SFR, floor without training", ours, lambda: _fitted(theirs(), shape, NO_STAGES)
    for row, aligned in (("MDM-SR", False), ("MDM-SR, limbs aligned first", True)):
        yield row, ours, partial(_copied, theirs, shape, aligned)
    for row, network in transfers_of(config.transfer).items():
        digest = "" if config.transfer is None else checkpoint_digest(config.transfer)
        yield row, ours + digest, partial(_transferred, theirs, shape, network)


def _drawn(
    config: DistortionConfig, path: Path, windows: Sequence[Window], feature: np.ndarray | None
) -> list[HandleMotion]:
    """One sample of a network for each window's sentence, by its own steps."""
    from bunraku.diffusion.generation.drawing import GUIDANCE, STEPS
    from bunraku.diffusion.generation.networks import load_generator

    model, encoder = load_generator(path)
    requests = [Request(window.sentence, window.frames) for window in windows]
    made = make_motions(
        model, encoder, requests, SamplerSettings(STEPS, GUIDANCE, seed=config.seed),
        folder=config.work / "motions", digest=checkpoint_digest(path), mesh_feature=feature,
    )  # fmt: skip
    return [decode(features) for features in made]


def _ours(config: DistortionConfig, path: Path, windows: Sequence[Window], shape: str, stages: Stages) -> np.ndarray:
    from bunraku.handles.predict import mesh_feature

    feature = mesh_feature(reference_body(shape).character())
    return _fitted(_drawn(config, path, windows, feature), shape, stages)


def _fitted(motions: Motions, shape: str, stages: Stages) -> np.ndarray:
    body = reference_body(shape)
    character, handles = body.character(), body.handles
    anatomy = Anatomy.of(character, handles)
    found = []
    for motion in motions:
        fitted = fit_motion(motion, anatomy, stages)
        moved = Animation(character, handles, fitted).vertices(np.arange(0, len(fitted), EVERY))
        found.append(body_samples(moved, body))
    return np.concatenate(found)


def _copied(motions: Callable[[], Motions], shape: str, aligned: bool) -> np.ndarray:
    body = reference_body(shape)
    rigged = rig_by_embedding(body.vertices, body.faces)
    thin = (skeleton_from_handles(motion.take(slice(None, None, EVERY))) for motion in motions())
    return np.concatenate([body_samples(copied_motion(rigged, motion, aligned), body) for motion in thin])


def _transferred(motions: Callable[[], Motions], shape: str, network: TransferNetwork) -> np.ndarray:
    body = reference_body(shape)
    character, handles = body.character(), body.handles
    found = []
    for motion in motions():
        source = source_motion(network, skeleton_from_handles(motion.take(slice(None, None, EVERY))))
        found.append(body_samples(transferred_motion(network, character, handles, source), body))
    return np.concatenate(found)
