"""The file beside a character's that says how its chains swing."""

from pathlib import Path

import numpy as np
import pytest

from bunraku import load_character
from bunraku.errors import FormatError
from bunraku.formats.mmd.export import save_pmx
from bunraku.physics.chains.chain import Chain, manner_of
from bunraku.physics.chains.manners_file import manners_beside, with_manners, write_manners
from bunraku_lab.synthetic.wardrobe import wardrobe_character

HAIR = Chain(
    "hair_1", "hair", np.array([1]), np.array([[0, 1, 0], [0, 0.8, 0.0]]), 0, np.array([0.02]), 0.01, manner_of("hair")
)


def test_kinds_and_names(tmp_path: Path) -> None:
    character = load_character(save_pmx(wardrobe_character(810_003), tmp_path / "one.pmx"))
    assert manners_beside(character) == {}
    (tmp_path / "one.apparel.toml").write_text("[hair]\nlimit = 30\nstiffness = 2\n[hair_1]\nstiffness = 5\n")
    told = manners_beside(character)
    (chain,) = with_manners([HAIR], told)
    assert chain.manner.limit == pytest.approx(np.radians(30)) and chain.manner.stiffness == 5
    assert chain.manner.damping == HAIR.manner.damping
    (other,) = with_manners([HAIR], {"skirt": {"limit": 3}})
    assert other is HAIR


@pytest.mark.parametrize(
    ("text", "said"),
    [("limit = 3", "outside"), ("[hair]\nlimits = 3", "not known"), ("[hair]\nlimit = 300", "from 0 to 90"),
     ("[hair]\nlimit = nan", "from 0 to 90"), ("[hair", "no TOML")],
)  # fmt: skip
def test_what_is_wrong_is_said(tmp_path: Path, text: str, said: str) -> None:
    character = load_character(save_pmx(wardrobe_character(810_003), tmp_path / "one.pmx"))
    (tmp_path / "one.apparel.toml").write_text(text)
    with pytest.raises(FormatError, match=said):
        manners_beside(character)


def test_what_is_written_changes_nothing_until_a_sign_is_taken_away(tmp_path: Path) -> None:
    character = load_character(save_pmx(wardrobe_character(810_003), tmp_path / "one.pmx"))
    path = tmp_path / "one.apparel.toml"
    facts = {"name": '前髪 "1"', "kind": "hair", "links": 3, "hangs_on": "head\n[tail]", "limit": 12.5,
             "stiffness": 0.3, "damping": 0.93, "gravity": 1.0, "mass": 0.5}  # fmt: skip
    write_manners([facts, {**facts, "name": "hair_1"}], path)
    assert manners_beside(character) == {'前髪 "1"': {}, "hair_1": {}}
    assert with_manners([HAIR], manners_beside(character)) == (HAIR,)
    path.write_text(path.read_text("utf-8").replace("# limit = 12.5", "limit = 40"), "utf-8")
    told = manners_beside(character)
    assert told["hair_1"] == {"limit": 40}
    (chain,) = with_manners([HAIR], told)
    assert chain.manner.limit == pytest.approx(np.radians(40))
