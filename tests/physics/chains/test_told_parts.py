"""Apparel of the networks that swings as a file beside the character's says."""

from dataclasses import replace

import numpy as np
import pytest

from bunraku.apparel.clothed import LOADS
from bunraku.apparel.swing import Swing
from bunraku.physics.chains.from_shape import shape_chains
from bunraku.physics.chains.told_parts import part_kinds, with_told_parts
from bunraku.physics.told.clothed import clothed_from_file
from bunraku_lab.synthetic.wardrobe import wardrobe_character


@pytest.fixture(scope="module")
def clothed():
    return clothed_from_file(wardrobe_character(810_003))


def test_a_part_is_as_stiff_as_its_kind_is_told(clothed) -> None:
    guessed = replace(clothed, swing=None)
    laid = shape_chains(guessed)
    kinds = np.array(part_kinds(guessed, laid))
    kind = laid.chains[0].kind
    assert kind in kinds
    told = with_told_parts(guessed, {kind: {"limit": 3.0, "damping": 0.5}})
    whole = [all(chain.kind == kind for chain in laid.chains if held) for held in kinds == kind]
    assert with_told_parts(guessed, {}) is guessed and with_told_parts(guessed, {"no such": {"limit": 1}}) is guessed
    moved = told.stiffness != guessed.stiffness
    assert moved[kinds == kind].all()
    if all(whole):
        assert told.stiffness[kinds == kind] == pytest.approx(LOADS - np.log10(np.radians(3.0)), abs=1e-4)
        assert told.damping[kinds == kind] == pytest.approx(0.5, abs=1e-5)
    others = ~np.isin(kinds, [kind, ""])
    np.testing.assert_allclose(told.stiffness[others], guessed.stiffness[others], atol=0.5)
    assert told.swing is None


def test_vertices_of_a_file_swing_as_far_as_the_links_of_their_chain(clothed) -> None:
    laid = shape_chains(clothed)
    longest = max(laid.chains, key=len)
    told = with_told_parts(clothed, {longest.name: {"limit": 2.0, "stiffness": 4.0, "gravity": 0.5}})
    assert told.swing is not None and clothed.swing is not None
    changed = np.flatnonzero((told.swing != clothed.swing).any(axis=1))
    assert len(changed) and np.isin(changed, laid.vertices).all()
    swing, before = Swing.of_rows(told.swing[changed]), Swing.of_rows(clothed.swing[changed])
    np.testing.assert_allclose(swing.upper, np.radians(2.0) * len(longest), rtol=1e-5)
    np.testing.assert_allclose(swing.lower, -swing.upper)
    assert (swing.weight == 0.5).all() and (swing.drag == before.drag).all()
