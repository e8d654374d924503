"""The table of things: each row is used, and its words are read."""

from bunraku.gestures.places import things_file
from bunraku.gestures.treading import read_treads
from bunraku.language.lexicon.things import named_in, things


def test_all_deeds_and_grounds_of_the_table_are_made_and_all_that_are_made_are_said():
    table, made = things(), things_file()
    deeds = {deed for kind in table.kinds.values() for deed in kind.deeds.values()} | set(table.defaults.values())
    assert deeds == set(made["deeds"])
    grounds = {one.name for some in table.grounds.values() for one in some}
    grounds |= {way for kind in table.kinds.values() for way in kind.going.values()}
    assert grounds == set(read_treads())
    said = {what for kind in table.kinds.values() for what in (*kind.deeds, *kind.going)}
    assert set(table.verbs.values()) >= said - {"see through"}
    assert {table.unknown.deeds[what] for what in table.unknown.deeds} <= deeds


def test_several_hundred_things_stand_where_people_of_that_height_meet_them():
    kinds = things().kinds
    assert len(kinds) > 700
    assert all(0.1 < kind.height < 2.1 for kind in kinds.values())
    order = ["kitten", "cat", "dog", "pony", "horse", "camel"]
    heights = [kinds[name].height for name in order]
    assert heights == sorted(heights) and len(set(heights)) == len(order)
    assert kinds["horse"].head > kinds["horse"].height


def test_the_longest_noun_counts():
    words = ["a", "steering", "wheel", "of", "a", "car"]
    found = [(one.start, one.stop, one.means.name) for one in named_in(things().kinds, words, 0, len(words))]
    assert found == [(1, 3, "wheel"), (5, 6, "vehicle")]
