"""Pixels of known scenes: coverage, depth order and the camera's promise."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.errors import OptionError
from bunraku.render import Camera, render_frames
from bunraku.render.frames import SoftwareRenderer
from bunraku.render.stage import Framing, build_surface, set_stage

SIZE = (96, 64)
RED, BLUE = (220, 20, 20), (20, 20, 220)
FRONT = Camera(np.array([0.0, 0.5, 10.0]), np.eye(3))  # looks along -z at the height of the middle
TRIANGLE = np.array([[-0.8, 0.1, 0.0], [1.1, 0.0, 0.0], [0.2, 1.3, 0.0]], np.float32)


def cube() -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (0, 2) for z in (-1, 1)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([(a, b, c) for q in quads for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])


def sphere(rings: int = 12, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    around = 2 * rings
    theta, phi = np.linspace(0, np.pi, rings + 1)[1:-1], np.arange(around) * 2 * np.pi / around
    body = np.stack(
        [
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), np.ones(around)),
            np.outer(np.sin(theta), np.cos(phi)),
        ],
        -1,
    )
    vertices = np.concatenate([body.reshape(-1, 3), [[0, 1, 0], [0, -1, 0]]])
    faces, top, bottom = [], len(vertices) - 2, len(vertices) - 1
    for k in range(around):
        following = (k + 1) % around
        faces.append((top, k, following))
        faces.append(((rings - 2) * around + k, bottom, (rings - 2) * around + following))
        for ring in range(rings - 2):
            a, b = ring * around + k, ring * around + following
            faces += [(a, a + around, b), (b, a + around, b + around)]
    return (vertices * radius).astype(np.float32), np.array(faces)


def is_red(picture: np.ndarray) -> np.ndarray:
    return picture[..., 0].astype(int) > picture[..., 1:].max(axis=-1).astype(int) + 60


@pytest.mark.parametrize("winding", [(0, 1, 2), (0, 2, 1)])
def test_triangle_covers_its_pixels_from_both_sides(winding):
    picture = render_frames(TRIANGLE[None], np.array([winding]), RED, FRONT, size=SIZE)[0]
    corners = FRONT.project(TRIANGLE, SIZE)[:, :2]
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    edges = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        across = np.array([end[1] - start[1], start[0] - end[0]]) / np.linalg.norm(end - start)
        edges.append((x - start[0]) * across[0] + (y - start[1]) * across[1])
    distance = np.min(edges, axis=0) if np.min(edges, axis=0).max() > 0 else np.min([-edge for edge in edges], axis=0)
    red = is_red(picture)
    assert (distance > 1).sum() > 100
    assert red[distance > 1].all()
    assert not red[distance < -1].any()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_nearer_triangle_wins(order):
    vertices = np.concatenate([TRIANGLE, TRIANGLE + [0, 0, 0.5]]).astype(np.float32)
    faces = np.array([(0, 1, 2), (3, 4, 5)])[list(order)]
    colors = np.array([BLUE] * 3 + [RED] * 3, np.uint8)
    picture = render_frames(vertices[None], faces, colors, FRONT, size=SIZE)[0]
    alone = render_frames(vertices[None, 3:], faces[:1] % 3, RED, FRONT, size=SIZE)[0]
    assert is_red(alone).sum() > 200
    assert is_red(picture)[is_red(alone)].all()


def test_floor_is_darker_under_a_character():
    vertices, faces = sphere()
    vertices = vertices + np.float32([0, 1, 0])
    with_it = render_frames(vertices[None], faces, size=(200, 160))[0].astype(int)
    # The same stage with nothing on it: a speck far too small to see keeps the camera.
    framing = Framing(1, (200, 160))
    framing.add(0, vertices)
    stage, camera = set_stage(framing), framing.camera()
    speck = (vertices * np.float32(1e-5)).astype(np.float32)
    empty = (
        SoftwareRenderer((200, 160), build_surface(speck, faces), stage).draw(speck, camera, np.zeros(3)).astype(int)
    )
    shadow = camera.project(np.array([0.0, 0.0, 0.0]) - 1.1 * stage.light * [1, 0, 1], (200, 160))
    column, row = int(shadow[0]), int(shadow[1])
    assert with_it[row, column].sum() < empty[row, column].sum() - 40
    assert np.abs(with_it[:10, :10] - empty[:10, :10]).max() <= 1


@pytest.mark.parametrize("walk", [0.0, 1.0, 2.5, 40.0])
@pytest.mark.parametrize("size", [(320, 240), (240, 320), (400, 100)])
def test_every_vertex_of_every_frame_is_in_the_picture(walk, size):
    rng = np.random.default_rng(int(walk))
    shape, frames = rng.normal(size=(50, 3)), 40
    path = np.linspace(0, walk, frames)[:, None] * np.array([0.6, 0.0, 0.8]) + rng.normal(size=(frames, 3)) * [
        0.1,
        0.3,
        0.1,
    ]
    posed = np.ascontiguousarray(shape + path[:, None], dtype=np.float32)
    framing = Framing(frames, size)
    for frame in range(frames):
        framing.add(frame, posed[frame])
    camera, offsets = framing.camera(), framing.offsets()
    pixels = np.stack(
        [camera.moved(offset).project(points, size) for points, offset in zip(posed, offsets, strict=True)]
    )
    assert pixels[..., 2].min() > 0
    inside = np.abs(pixels[..., :2] / size * 2 - 1)
    assert inside.max() < 0.91
    assert inside.max() > 0.89  # and no farther away than that needs
    assert (np.ptp(offsets, axis=0).max() > 0) == (walk >= 40)


def test_creases_are_kept_and_seams_are_not_seen():
    vertices, faces = cube()
    assert len(build_surface(vertices, faces).point_vertex) == 24
    vertices, faces = sphere()
    whole = build_surface(vertices, faces)
    assert len(whole.point_vertex) == len(vertices)
    # A seam: every face has its own copies of its vertices.
    opened, own = vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3)
    torn = build_surface(opened, own)
    _, normals = torn.pose(opened)
    points, expected = whole.pose(vertices)
    assert np.abs(points - vertices[whole.point_vertex]).max() == 0
    assert np.abs(normals[torn.triangles] - expected[whole.triangles]).max() < 1e-5
    assert np.einsum("pi,pi->p", expected, points).min() > 0.98


@pytest.mark.parametrize(
    "options",
    [
        {"size": (8, 8)},
        {"size": (64, 9999)},
        {"colors": np.zeros((5, 3))},
        *({"background": bad} for bad in ("plaid", (1, 2), "#12345g")),
    ],
)
def test_bad_options_are_refused(options):
    with pytest.raises(OptionError):
        render_frames(TRIANGLE[None], np.array([(0, 1, 2)]), **options)


@pytest.mark.parametrize(("floor", "lift", "ground"), [(None, 0.0, -0.3), (0.0, 0.0, 0.0), (0.0, 5.0, 4.7)])
def test_the_ground_is_where_the_rest_pose_stands_unless_the_motion_is_elsewhere(floor, lift, ground):
    framing = Framing(10, (200, 160), floor=floor)
    for frame in range(10):  # a tall thing whose sword hangs 0.3 m through the floor
        framing.add(frame, np.array([[0, lift - 0.3, 0], [1, lift + 2, 0], [0, lift + 2, 1]], np.float32))
    assert framing.ground == pytest.approx(ground, abs=1e-6)
