import pytest

from bunraku.language.lexicon.reading import in_known_words
from bunraku.language.understood import understood


@pytest.mark.parametrize(
    ("said", "known"),
    [
        ("a person twirls around", "a person spins around"),
        ("someone is twirling to the left", "someone is spinning to the left"),
        ("a boy tiptoes away", "a boy sneaks away"),
        ("she walks on her tiptoes", "she sneaks"),
        ("a girl bounces a ball", "a girl dribbles a basketball"),
        ("she flings a stone, then collapses", "she throws a stone, then falls down"),
        ("she flings her arms up", "she flings her arms up"),
        ("a woman saunters ahead at a leisurely pace", "a woman strolls ahead slowly"),
        ("he lowers himself onto a chair", "he sits down on a chair"),
        ("a boy sneaks a look over his shoulder", "a boy looks over his shoulder"),
        ("she whirls around to face him", "she turns around to face him"),
        ("somebody gets down on all fours and crawls", "somebody crawls on all fours"),
        ("he makes a quarter turn to the left", "he turns left"),
        ("a boy is doing a 90-degree turn to his right", "a boy is turning right"),
        ("she makes a half turn", "she turns around"),
        ("a woman climbs a flight of stairs", "a woman climbs stairs"),
        ("somebody trips and nearly falls", "somebody stumbles"),
        ("a child is balancing on the left leg", "a child is standing on the left leg"),
        ("a dog bounces", "a dog bounces"),
        ("a person walks", "a person walks"),
    ],
)
def test_rare_words_become_those_of_the_captions_in_the_same_form(said, known):
    assert in_known_words(said) == known


def test_unknown_words_beside_them_keep_their_places():
    found = understood("a person pirouettes and snoofles")
    assert found.english == "a person spins and snoofles"
    assert [(word.word, word.start, word.stop) for word in found.unknown] == [("snoofles", 24, 32)]
