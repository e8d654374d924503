"""Motion of the reference body for programs that speak the Motion Model Context Protocol (MMCP), by its SDK.

The protocol asks for motion on a skeleton and knows no meshes: what is answered is what `bunraku.generate` gives, on
the 22 joints of the reference body in its T-pose. Programs carry it to their own rigs.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np

from bunraku.core.ground_path import GroundPath
from bunraku.core.motion import SkeletalMotion
from bunraku.core.request.limits import CANDIDATES, SECONDS
from bunraku.core.resample import resample_motion
from bunraku.errors import BunrakuError, MissingExtraError, OptionError
from bunraku.geometry.rotations import quaternion_from_matrix
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests.constraints import Constraints
from bunraku.pipelines.requests.request import Request, Sampling

__all__ = ["MODEL", "mmcp_app"]

MODEL = "bunraku"
FPS = 20.0
UNSAID = "idles"
"""What a stretch without a sentence is made of."""


def mmcp_app() -> Any:
    """The server, an ASGI application with `GET /capabilities` and `POST /generate`.

    Raises:
        MissingExtraError: The SDK is not installed.
    """
    try:
        from motionmcp.backbone import Backbone, Limits, ModelSpec, MotionResult
        from motionmcp.errors import ProtocolError
        from motionmcp.schemas import Skeleton
        from motionmcp.server import build_app
    except ImportError as error:
        raise MissingExtraError("motionmcp-sdk", "mmcp", "`bunraku serve --mmcp`") from error

    turn = threading.Lock()  # networks are made for one call at a time

    class Model(Backbone):  # type: ignore[misc]  # the SDK brings no types
        """Bunraku as a model of the protocol."""

        def capabilities(self) -> Any:
            return ModelSpec(
                id=MODEL, fps=FPS, canonical_skeleton=Skeleton(joints=_joints()), supports_loop=True,
                supported_constraints=["root_path"], supported_guidance_types=["nocfg", "regular"],
                native_clip_seconds=10.0, chunking="stitched", recommended_max_duration_seconds=20.0,
                limits=Limits(max_duration_seconds=SECONDS.high, max_num_samples=min(8, int(CANDIDATES.high))),
            )  # fmt: skip

        def generate(self, request: Any) -> Any:
            try:
                with turn:
                    motions, notes = _generated(request)
            except BunrakuError as error:
                raise ProtocolError("invalid_request", str(error)) from None
            frames = request.total_frames
            return MotionResult(
                rotations=np.stack([_lasting(quaternion_from_matrix(one.rotations), frames) for one in motions]),
                root_translations=np.stack([_lasting(one.root_translation, frames) for one in motions]),
                notes=[{"code": "note", "severity": "info", "message": note} for note in notes],
            )

    return build_app(Model(), title="Bunraku")


def _joints() -> list[dict[str, object]]:
    """The reference body's joints as the protocol has them: parents by name, rest positions from them [m]."""
    from bunraku.body.reference import reference_body

    skeleton = reference_body().skeleton
    return [
        {
            "name": name, "parent": skeleton.names[parent] if parent >= 0 else None,
            "rest_translation": tuple(map(float, offset)), "rest_rotation": (0.0, 0.0, 0.0, 1.0),
        }
        for name, parent, offset in zip(skeleton.names, skeleton.parents, skeleton.offsets, strict=True)
    ]  # fmt: skip


def _generated(asked: Any) -> tuple[list[SkeletalMotion], list[str]]:
    """The samples of a request at its rate, and what is to be said of them."""
    from bunraku.io.skeletal import as_skeletal

    options, rate, notes = asked.options, asked.fps(FPS), list[str]()
    parts = [(getattr(one, "prompt", UNSAID), one.duration_frames / rate) for one in asked.segments]
    parts = parts or [(UNSAID, asked.duration_frames / rate)]
    if len(parts) > 1 and any(";" in prompt for prompt, _ in parts):
        raise OptionError("a segment holds one sentence; put those after a semicolon into segments of their own")
    sentence = parts[0][0] if len(parts) == 1 else "; ".join(f"{prompt}:{seconds:g}" for prompt, seconds in parts)
    path = None
    for one in asked.constraints:
        path = GroundPath(tuple(one.positions_xz), tuple(frame / rate for frame in one.frames))
        if one.heading_radians is not None:
            notes.append("who follows a path faces along it; its headings are left out")
    guidance = options.guidance if options else None
    sampling = Sampling(sum(seconds for _, seconds in parts))
    if guidance is not None:
        sampling = replace(sampling, guidance=guidance.weight[0] if guidance.weight else 0.0)
    seed = next((one.seed for one in asked.segments if one.seed is not None), options.seed if options else None)
    request = Request(sentence, sampling, Constraints.of(loop=bool(options and options.loop), path=path))
    count = options.num_samples if options else 1
    first = int(np.random.default_rng().integers(1 << 31)) if seed is None else int(seed)
    motions = Animator.shipped(note=notes.append).generate(
        [request.with_seed(first + number) for number in range(count)], [first + number for number in range(count)]
    )
    return [resample_motion(as_skeletal(motion), rate) for motion in motions], notes


def _lasting(values: np.ndarray, frames: int) -> np.ndarray:
    """As many frames as were asked for: the last is held where rounding left one out."""
    return values[np.minimum(np.arange(frames), len(values) - 1)].astype(np.float32)
