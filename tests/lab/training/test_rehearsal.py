"""Runs that go on with few clips: what is rehearsed, and what their cards say."""

from dataclasses import replace

import numpy as np
import pytest

from bunraku.diffusion.examples.pack import load_examples
from bunraku.diffusion.features import FeatureStatistics
from bunraku_lab.training.diffusion.card import training_card, write_card
from bunraku_lab.training.diffusion.config import TrainingConfig
from bunraku_lab.training.rows.clip_data import ClipEntry
from bunraku_lab.training.rows.clip_rows import ClipSet, Mixture
from bunraku_lab.training.rows.rehearsal import rehearsal_clips


@pytest.fixture(scope="module")
def clips():
    pack = load_examples()
    if pack is None:
        pytest.skip("the shipped examples are not there")
    told = [one for one in pack.examples if one.texts and not one.made]
    places = [pack.examples.index(one) for one in told[:20]]
    few = replace(pack, examples=tuple(told[:20]), data=tuple(pack.data[place] for place in places))
    known = rehearsal_clips(few)
    features = next(iter(known.values()))["features"]
    own = ClipEntry(
        features=features, frames=len(features), texts=["a person yodels"], watched=True, licence="CC BY 4.0",
        credit="A. Person",
    )  # fmt: skip
    return {"own_yodel": own} | known


def test_the_share_of_what_is_rehearsed_is_that_which_is_wanted(clips):
    statistics = FeatureStatistics.measure([entry["features"] for entry in clips.values()])
    rows = ClipSet(clips, statistics, mixture=Mixture(creatures=0.0, borrowed=0.0, events=0.0, rehearse=0.75))
    known = np.array([clip.rehearsed for clip in rows.clips])
    assert known.sum() == 20 and rows.probability[known].sum() == pytest.approx(0.75)
    assert rows.probability[~known].sum() == pytest.approx(0.25)
    alone = ClipSet({"own_yodel": clips["own_yodel"]}, statistics, mixture=Mixture(rehearse=0.75))
    assert alone.probability.tolist() == [1.0]


def test_the_card_names_terms_and_people_also_of_what_the_run_started_from(clips, tmp_path):
    start = tmp_path / "first.safetensors"
    write_card(start, "# Model card\n\n- no credit\n\n## Credits\n\n- Somebody. Licence: MIT.\n")
    own = {"own_yodel": clips["own_yodel"], "cmu_01_01": clips["own_yodel"] | {"licence": "CMU", "credit": ""}}
    card = training_card(own, TrainingConfig(start=start))
    seconds = len(clips["own_yodel"]["features"]) / 20
    assert f"| CC BY 4.0 | {seconds / 60:.1f} |" in card and "first.safetensors" in card
    assert "- A. Person. Licence: CC BY 4.0." in card and "mocap.cs.cmu.edu" in card
    assert "- Somebody. Licence: MIT." in card and "- no credit" not in card
