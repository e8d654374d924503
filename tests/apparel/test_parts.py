"""The parts of a character, and what they are to its handles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.handles.predict import predict_handles
from bunraku.apparel.part_network import PARTS
from bunraku.apparel.parts import Parts, handles_of_body, off_limbs, part_point, parts_of
from bunraku.core.body.corrections import SUFFIX, Corrections, Piece
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character
from bunraku.files import load_character, save_character
from bunraku.files.samples import sample_character


def rod(start, end, radius=0.02) -> tuple[np.ndarray, np.ndarray]:
    """A closed tube from one point to another."""
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    line = (np.asarray(end) - start) / np.linalg.norm(np.asarray(end) - start)
    side = np.cross(line, [0.3, 0.2, 1.0])
    side /= np.linalg.norm(side)
    ring = radius * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(line, side))
    points = (start + np.linspace(0, 1, 12)[:, None] * (np.asarray(end) - start))[:, None] + ring
    a = (np.arange(11)[:, None] * 8 + np.arange(8)).reshape(-1)
    b = (np.arange(11)[:, None] * 8 + (np.arange(8) + 1) % 8).reshape(-1)
    faces = np.concatenate([np.stack([a, b, a + 8], axis=1), np.stack([b, b + 8, a + 8], axis=1)])
    return points.reshape(-1, 3), faces


def with_rods(kind: str, *rods) -> tuple[Character, np.ndarray]:
    """The reference body with rods that are of a kind, and which vertices these are."""
    body = reference_body()
    vertices, faces = [body.vertices], [body.faces]
    for points, own in rods:
        faces.append(own + sum(map(len, vertices)))
        vertices.append(points)
    count = sum(map(len, vertices))
    added = np.arange(count) >= len(body.vertices)
    said = Corrections(part=(Piece(kind, tuple(tuple(point) for points, _ in rods for point in points[::8].tolist())),))
    return Character("rods", np.concatenate(vertices), np.concatenate(faces), corrections=said), added


def test_tails_of_hair_are_no_limbs():
    """Two tails as thick as arms hang beside the arms: all of them goes with the head, and the arms stay arms."""
    head = reference_body().joints[15]
    tails = [rod(head + [side * 0.1, 0.1, -0.05], [side * 0.35, 0.3, -0.1], 0.05) for side in (-1, 1)]
    character, added = with_rods("hair", *tails)
    handles = handles_of_body(character, predict_handles)
    low = added & (character.vertices[:, 1] < head[1])
    assert (handles.weights[low].argmax(axis=1) == HANDLE_NAMES.index("head")).all()
    alone = predict_handles(reference_body().character())
    np.testing.assert_allclose(handles.positions[16:22], alone.positions[16:22], atol=0.03)


def test_a_staff_goes_as_a_whole_with_the_hand_that_holds_it():
    wrist = reference_body().joints[20]
    character, added = with_rods("prop", rod(wrist + [0.08, -0.6, 0.03], wrist + [0.08, 0.7, 0.03]))
    weights = handles_of_body(character, predict_handles).weights[added]
    assert (weights.max(axis=1) > 0.999).all() and len(set(weights.argmax(axis=1))) == 1
    assert HANDLE_NAMES[int(weights[0].argmax())] in ("left_wrist", "left_fingers")


def test_a_figure_glides_with_the_base_that_it_stands_on():
    """The base goes with the root, the legs on it do not bend, and the arms go with the chest."""
    beam, added = with_rods("ground", rod([-0.3, -1, 0.1], [0.3, -1, 0.1], 0.12))
    parts = parts_of(beam)
    assert {parts.kinds[number] for number in parts.number[added]} == {"ground"}
    weights = handles_of_body(beam, predict_handles).weights
    assert (weights[added, 0] == 1).all()
    limbs = ("hip", "knee", "ankle", "foot", "shoulder", "elbow", "wrist", "fingers")
    assert weights[:, [name.endswith(limbs) for name in HANDLE_NAMES]].max() == 0
    alone = predict_handles(reference_body().character()).weights
    hand = ~added
    hand[~added] = alone[:, HANDLE_NAMES.index("left_wrist")] > 0.5
    assert weights[hand, HANDLE_NAMES.index("spine3")].min() > 0.9


def test_a_cape_goes_with_the_chest_and_a_sleeve_with_its_arm():
    chest, elbow = HANDLE_NAMES.index("spine3"), HANDLE_NAMES.index("left_elbow")
    kinds, carriers = ("cape", "sleeve"), ("chest", "left arm")
    number = np.array([-1, 0, 0, 1])
    label = np.array([PARTS.index(kind) for kind in ("body", "cape", "cape", "sleeve")], np.int8)
    weights = np.zeros((4, len(HANDLE_NAMES)), np.float32)
    weights[:, elbow], weights[1, elbow], weights[1, chest] = 1, 0.4, 0.6
    off_limbs(Parts(label, number, number >= 0, kinds, carriers), weights)
    assert weights[:, elbow].tolist() == [1, 0, 0, 1] and weights[1:3, chest].tolist() == [1, 1]


def test_a_part_has_the_kind_that_it_is_given_also_from_the_file_beside(tmp_path):
    dancer = sample_character("dancer")
    parts = parts_of(dancer)
    number = parts.kinds.index("skirt")
    mine = parts.number == number
    assert parts.carriers[number] == "pelvis" and parts.hangs[mine].mean() > 0.8
    worn = Corrections(part=(Piece("accessory", (part_point(dancer, parts, number),)),))
    stiff = parts_of(replace(dancer, corrections=worn))
    assert (stiff.label[mine] == PARTS.index("accessory")).all() and not stiff.hangs[mine].any()
    assert stiff.hangs[parts.hangs & ~mine].all()
    limb = Corrections(part=(Piece("arm", worn.part[0].at),))  # what is a limb is of the body, and swings no more
    assert not parts_of(replace(dancer, corrections=limb)).hangs[mine].any()
    path = save_character(dancer, tmp_path / "dancer.glb")
    at = list(part_point(dancer, parts, number))
    path.with_name(f"dancer{SUFFIX}").write_text(f'[[part]]\nkind = "cape"\nat = [{at}]\n')
    told = parts_of(load_character(path))
    assert "cape" in told.kinds and "skirt" not in told.kinds


def test_what_is_found_has_no_holes():
    """Each part of the dancer is large, and the same mesh scaled and moved has the same parts."""
    dancer = sample_character("dancer")
    parts = parts_of(dancer)
    assert len(parts) < 12 and (dancer.areas[parts.label == 0].sum() > 0.2 * dancer.areas.sum())
    moved = parts_of(replace(dancer, vertices=2 * dancer.vertices + [0, 1, 0], source=None))
    assert (moved.label == parts.label).mean() > 0.98
