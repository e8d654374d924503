"""On what apparel is looked for, and how much of it is believed."""

import numpy as np

from bunraku.pipelines.animate import rig
from bunraku.pipelines.clothes import MOST, apparel_of, too_much
from bunraku.samples import sample_character


def test_animals_wear_nothing() -> None:
    dog = sample_character("dog")
    assert not apparel_of(dog, rig(dog)).any()


def test_a_mask_counts_on_anybody() -> None:
    dog = sample_character("dog")
    mask = dog.vertices[:, 1] > np.quantile(dog.vertices[:, 1], 0.8)
    assert apparel_of(dog, rig(dog), mask).any()


def test_too_much_is_asked_about() -> None:
    person = sample_character("person")
    order = np.argsort(person.vertices[:, 1])
    share = np.cumsum(person.areas[order]) / person.areas.sum()
    little, much = np.zeros(len(order), bool), np.zeros(len(order), bool)
    little[order[share < MOST - 0.05]] = True
    much[order[share < MOST + 0.05]] = True
    assert too_much(person, little) == ""
    assert f"{MOST + 0.05:.0%}" in too_much(person, much) and "mask" in too_much(person, much)
