import re

import pytest

from bunraku_lab.evaluation.report import Bar, Report, Table, bar_table, measured_in, percent, reached_bars


@pytest.mark.parametrize(
    ("least", "most", "limit", "good", "bad"),
    [(0.7, None, ">= 0.7", 0.7, 0.69), (None, 3, "<= 3", 3, 3.1), (60, 130, "60..130", 100, 131)],
)
def test_bars(least, most, limit, good, bad):
    bar = Bar("title", least, most)
    assert bar.limit == limit and bar.reached(good) and not bar.reached(bad)
    assert not Bar("title").limit


def test_bars_know_both_directions():
    assert Bar("", most=0.1).reached(0.1) and not Bar("", most=0.1).reached(0.2)
    assert Bar("", least=0.9).reached(0.95) and not Bar("", least=0.9).reached(0.8)
    assert Bar("").reached(1.0) is None and Bar("", most=0.1).reached(None) is None


BARS = {
    "share": Bar("a share", least=0.9, show=percent(1)),
    "speed": Bar("its speed", most=0.01, show=measured_in(" m/s", 4)),
    "told": Bar("only told"),
    "none": Bar("not measured", most=0.25, show=measured_in("", 3), show_limit="{:g}".format),
}


def test_figures_are_printed_beside_their_bars():
    result = {"share": 0.95, "speed": 0.02, "told": 12.345, "none": None}
    assert bar_table(BARS, result).text().splitlines() == [
        "measure            value            bar  reached",
        "a share            95.0%       >= 90.0%  yes",
        "its speed     0.0200 m/s  <= 0.0100 m/s  no",
        "only told           12.3",
        "not measured           -        <= 0.25",
    ]
    assert reached_bars(BARS, result) == {"share": True, "speed": False, "none": None}
    assert bar_table(BARS, result, reached={"share": False}).rows[1][-1] == "no"


def test_columns_are_as_wide_as_what_is_in_them():
    assert Table([["", "a", "long name"], ["first row", "1.5", "2"]], title="what it is").text().splitlines() == [
        "what it is",
        "             a  long name",
        "first row  1.5          2",
    ]
    assert Table([["name", "said"], ["x", "yes"], ["y", ""]]).text() == "name  said\nx     yes\ny"


def test_a_report_in_markdown_is_read_as_the_tables_that_it_holds():
    markdown = pytest.importorskip("markdown")
    report = Report(["3 characters", Table([["name", "share"], ["a|b", "1.5"], ["c", "20"]], title="shares")])
    page = markdown.markdown(report.markdown(), extensions=["tables"])
    cells = re.findall(r"<t[hd](?: style=\"text-align: (\w+);\")?>(.*?)</t[hd]>", page)
    assert page.startswith("<p>3 characters</p>") and "<strong>shares</strong>" in page
    assert [text for _, text in cells] == ["name", "share", "a|b", "1.5", "c", "20"]
    assert [side for side, _ in cells] == ["", "right"] * 3
