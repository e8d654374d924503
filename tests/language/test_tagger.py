"""Words that the table of other languages does not have, read by the network."""

import numpy as np
import pytest

from bunraku.language.foreign import tagger
from bunraku.language.foreign.sentence import english_sentence
from bunraku.language.foreign.spaced import scan_spaced
from bunraku.language.foreign.table import Concept
from bunraku.language.foreign.tagger import load_tagger, tagged, units
from bunraku.language.lexicon.reading import actions_of
from bunraku.language.parse import parse
from bunraku.language.words import translate


def test_units_are_the_words_of_a_sentence_and_the_signs_of_one_without_spaces():
    text = "L'homme s’élance, 2 fois !"
    assert [text[unit.start : unit.stop] for unit in units(text, "fr")] == ["L'", "homme", "s’", "élance", "fois"]
    text = "人が、3回 跳ねる。"
    assert "".join(text[unit.start : unit.stop] for unit in units(text, "ja")) == "人が3回跳ねる"
    assert units("Füße", "de")[0].pieces == units("füsse", "de")[0].pieces != units("fusse", "fr")[0].pieces


def test_each_movement_of_the_network_is_one_action_in_english():
    network = load_tagger()
    assert len(network.config.verbs) >= 50
    for verb in network.config.verbs:
        assert len(actions_of(english_sentence([Concept("verb", verb, 0, 1)], "de"))) == 1, verb


def test_what_a_word_says_depends_on_what_stands_beside_it():
    network = load_tagger()
    alone = network(units("Person", "de"), "de")[0]
    beside = network(units("Person tanzt", "de"), "de")[0]
    assert alone.shape == (len(network.config.verbs),) and not np.allclose(alone, beside)
    assert ((alone >= 0) & (alone <= 1)).all()


class Sure:
    """A network that knows two words."""

    config = tagger.TaggerConfig(verbs=("{wave}", "{kick}"))

    def __init__(self, text, **known):
        self.text, self.known = text, known

    def __call__(self, found, language):
        verbs = self.config.verbs
        words = [self.text[unit.start : unit.stop] for unit in found]
        return np.array([[0.9 * (self.known.get(word) == verb) for verb in verbs] for word in words])


@pytest.mark.parametrize(
    ("text", "english"),
    [
        (
            "Eine Person wuppert zweimal mit der linken Hand und bulxt dann mit dem rechten Fuß",
            "a person waves with the left hand twice, then kicks with the right foot",
        ),
        ("Eine Person bulxt, dann wuppert sie", "a person kicks, then waves"),
        ("Eine Person winkt wuppert", "a person waves"),
    ],
)
def test_sides_numbers_and_order_of_a_word_that_the_network_reads_are_the_tables(text, english, monkeypatch):
    monkeypatch.setattr(tagger, "load_tagger", lambda: Sure(text, wuppert="{wave}", bulxt="{kick}"))
    assert translate(text).english == english
    nothing = translate("Eine Person brummelt")
    assert nothing.language == "en" and not nothing.concepts


def test_without_weights_the_table_reads_alone(monkeypatch, tmp_path):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    concepts = scan_spaced("Eine Person wuppert und geht", "de")
    assert tagged("Eine Person wuppert und geht", "de", concepts) == concepts
    assert parse("Eine Person wuppert und geht").clauses[0].actions == ("walk",)
