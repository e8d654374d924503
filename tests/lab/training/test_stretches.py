from bunraku_lab.training.rows.stretches import agreeing, joined_sentence, stretch_phrases, stretch_variants

TEXTS = ("someone walks fast and turns left", "a brisk walk with a left turn", "walk fast, turn left")


def test_the_tersest_sentence_gives_a_phrase_where_it_begins_with_a_verb():
    assert stretch_phrases(TEXTS) == ("{walk} fast, {turn} left",)
    assert stretch_phrases(("a person walks", "brisk walk")) == ()


def test_variants_keep_what_is_written_and_change_the_subject():
    found = stretch_variants(TEXTS)
    assert set(TEXTS) <= set(found) and "a person walks fast, turns left" in found
    others = [text for text in found if text.endswith("walks fast and turns left")]
    assert len(others) == 2 and others[0] != others[1]
    mirrored = stretch_variants(TEXTS, (), True)
    assert len(mirrored) == len(found) and all("right" in text and "left" not in text for text in mirrored)


def test_labels_join_in_only_where_they_say_the_same():
    assert agreeing(("a person kicks with the right leg",), ("kick",))
    assert not agreeing(("a person walks",), ("kick",))


def test_sentences_of_stretches_that_follow_become_one():
    assert (
        joined_sentence(["a person sits down", "someone gets up and walks off"])
        == "a person sits down, then gets up and walks off"
    )
