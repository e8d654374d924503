"""The compiled loops against those in numpy, welding, and frames that are drawn side by side."""

from __future__ import annotations

import os
import shutil
import threading

import numpy as np
import pytest
from tubes import swinging

from bunraku.render import frames as frames_module
from bunraku.render import kernels, render_frames
from bunraku.render.frames import draw_parallel
from bunraku.render.kernels import SOURCE, Native, compile_kernels
from bunraku.render.stage import Camera

COMPILED = kernels.native()


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames, faces and colours of rough ground with a tower and a loose leaf, whose faces are of all sizes."""
    rng = np.random.default_rng(5)
    x, z = np.meshgrid(np.linspace(-1, 1, 30), np.linspace(-1, 1, 30))
    ground = np.stack([x, 0.3 + 0.1 * rng.normal(size=x.shape), z], -1).reshape(-1, 3)
    corner = np.arange(29 * 30).reshape(29, 30)[:, :-1].ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 30], 1), np.stack([corner + 31, corner + 30, corner + 1], 1)]
    )
    loose = np.array([[0, 0, 0], [0.5, 2.0, 0.1], [-0.4, 1.4, 0.3], [0.9, 1.0, 0.9], [0.9, 1.0, 0.2], [0.5, 1.1, 0.5]])
    vertices = np.concatenate([ground, loose]).astype(np.float32)
    faces = np.concatenate([faces, len(ground) + np.array([[0, 1, 2], [3, 4, 5]])])
    path = np.linspace(0, 8, 5)[:, None] * [0.6, 0, 0.8]
    frames = vertices + path[:, None].astype(np.float32)
    return frames, faces, rng.integers(20, 230, (len(vertices), 3)).astype(np.uint8)


@pytest.mark.skipif(COMPILED.library is None, reason=COMPILED.reason)
@pytest.mark.parametrize("background", ["studio", "dark"])
def test_compiled_loops_draw_what_numpy_draws(monkeypatch, background):
    posed, faces, colors = scene()
    how = {"size": (200, 150), "background": background}
    compiled = render_frames(posed, faces, colors, **how).astype(int)
    monkeypatch.setattr(kernels, "native", lambda: Native(None, "a test"))
    plain = render_frames(posed, faces, colors, **how).astype(int)
    difference = np.abs(compiled - plain).max(axis=-1)
    assert difference.mean() < 0.02
    assert (difference > 2).mean() < 1e-3  # samples on an edge may go to either face
    assert len(np.unique(compiled.reshape(-1, 3), axis=0)) > 1000


def test_a_compiler_that_fails_leaves_no_file_and_numpy_draws(tmp_path, monkeypatch):
    (tmp_path / "bin").mkdir()
    broken = tmp_path / "bin" / "cc"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setattr(kernels, "_folders", lambda: [tmp_path / "kept"])
    found = kernels.native.__wrapped__()
    assert found.library is None and "cc" in found.reason
    assert not list((tmp_path / "kept").iterdir())
    broken.unlink()
    assert "no C compiler" in kernels.native.__wrapped__().reason
    monkeypatch.setenv("BUNRAKU_KERNELS", "numpy")
    assert "BUNRAKU_KERNELS" in kernels.native.__wrapped__().reason


@pytest.mark.skipif(shutil.which("cc") is None or os.name != "posix", reason="no C compiler cc")
def test_a_library_that_others_may_write_is_not_loaded(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "_folders", lambda: [tmp_path])
    found = kernels.native.__wrapped__()
    (path,) = tmp_path.iterdir()
    assert found.library is not None and found.reason == str(path)
    path.chmod(0o777)
    assert kernels.native.__wrapped__().library is None
    compile_kernels("cc", tmp_path / "again.so")
    assert (tmp_path / "again.so").stat().st_size > 5000 and SOURCE.is_file()


def test_vertices_that_look_and_move_alike_are_drawn_as_one():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [5, 5, 5]], np.float32)
    faces = np.array([[0, 1, 2], [5, 4, 3]])
    kept, corners = frames_module._welded(vertices, faces, None, None)
    assert kept.tolist() == [0, 1, 2, 5] and corners.tolist() == [[0, 1, 2], [3, 2, 1]]
    weights = np.tile(np.float32([1, 0]), (7, 1))
    weights[3] = 0.5, 0.5
    assert frames_module._welded(vertices, faces, None, weights)[0].tolist() == [0, 1, 2, 3, 5]
    colors = np.zeros((7, 3), np.uint8)
    colors[4] = 255
    assert frames_module._welded(vertices, faces, colors, weights)[0].tolist() == [0, 1, 2, 3, 4, 5]


def test_welded_faces_give_the_same_picture():
    """Every face with vertices of its own, as STL has them."""
    whole = swinging(frames=3)
    faces = whole.character.faces
    torn = type(whole)(
        type(whole.character)(
            "torn",
            whole.character.vertices[faces.ravel()],
            np.arange(faces.size).reshape(-1, 3),
            colors=whole.character.colors[faces.ravel()],
        ),
        type(whole.handles)(whole.handles.positions, whole.handles.weights[faces.ravel()]),
        whole.motion,
    )
    one, other = (
        np.stack(list(frames_module.render_animation(each, size=(96, 96)))).astype(int) for each in (whole, torn)
    )
    assert len(frames_module._take(torn, np.zeros(1), "texture").rest) == len(whole.character.vertices)
    assert np.abs(one - other).max(axis=-1).mean() < 0.01


class Recorder:
    """A renderer that writes its frame's number and notes who drew."""

    def __init__(self, threads: set[int], fail_at: int = -1):
        self.threads, self.fail_at = threads, fail_at
        self.busy = threading.Lock()

    def draw(self, vertices: np.ndarray, camera: Camera, offset: np.ndarray) -> np.ndarray:
        assert self.busy.acquire(blocking=False)  # one frame at a time each
        self.threads.add(threading.get_ident())
        if int(vertices[0, 0]) == self.fail_at:
            self.busy.release()
            raise ValueError("no such frame")
        picture = np.full((2, 2, 3), int(vertices[0, 0]), np.uint8)
        self.busy.release()
        return picture


CAMERA = Camera(np.zeros(3), np.eye(3))


def numbered(count: int):
    return ((np.full((1, 3), index, np.float32), CAMERA, np.zeros(3)) for index in range(count))


def drawing_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("bunraku-preview")]


def test_frames_come_in_their_order_and_threads_end():
    def opened() -> Recorder:
        return Recorder(set())

    assert [int(picture[0, 0, 0]) for picture in draw_parallel(opened, numbered(50))] == list(range(50))
    assert drawing_threads() == []
    assert list(draw_parallel(opened, numbered(0))) == []
    pictures = draw_parallel(opened, numbered(50))
    next(pictures)
    pictures.close()
    assert drawing_threads() == []


def test_what_a_renderer_raises_arrives():
    pictures = draw_parallel(lambda: Recorder(set(), fail_at=3), numbered(9))
    assert [int(next(pictures)[0, 0, 0]) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="no such frame"):
        next(pictures)
    assert drawing_threads() == []
