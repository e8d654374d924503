"""The papers' tables."""

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_y
from bunraku_lab.cli.evaluate_motion import EvaluateTables
from bunraku_lab.evaluation.report import Report
from bunraku_lab.evaluation.tables.measured import PAPERS, TablesConfig, measure_tables
from bunraku_lab.evaluation.tables.paper_table import Group, PaperRow, PaperTable, measured_table, shown_table
from bunraku_lab.evaluation.tables.tapmo import body_samples

TABLE = PaperTable(
    "tapmo", 9, "a table", ("loss",),
    (PaperRow("base", (0.8,)), PaperRow("ours", (0.2,)), PaperRow("other", (0.4,), "no data")), "base", "A note.",
)  # fmt: skip


def test_both_sides_are_over_their_own_reference():
    found = measured_table(TABLE, {"base": {"loss": 3.0}, "ours": {"loss": 1.5}})
    base, ours, other = (row["cells"]["loss"] for row in found["rows"])
    assert (base["paper_over_reference"], base["ours_over_reference"]) == (1, 1)
    assert ours["paper_over_reference"] == pytest.approx(0.25) and ours["ours_over_reference"] == pytest.approx(0.5)
    assert other["ours"] is None and other["ours_over_reference"] is None
    assert [row["not_run"] for row in found["rows"]] == ["", "", "no data"]
    shown = Report(shown_table(found)).markdown()
    assert "| ours | 0.2 / 1.5 | 0.25 / 0.5 |" in shown and "not run: other: no data" in shown and "A note." in shown


def test_what_was_measured_is_kept_until_what_it_depends_on_changes(tmp_path):
    calls = []
    weights = tmp_path / "weights"
    weights.write_bytes(b"one")

    def run(parts):
        calls.append(1)
        return {"ours": {"loss": 1.0}}

    for expected in (1, 1):
        assert Group("some", run, {"weights": weights}).figures(tmp_path / "work") == {"ours": {"loss": 1.0}}
        assert len(calls) == expected
    weights.write_bytes(b"two")
    Group("some", run, {"weights": weights}).figures(tmp_path / "work")
    Group("some", run, {"weights": weights, "quick": True}).figures(tmp_path / "work")
    assert len(calls) == 3


def test_a_measurement_that_was_stopped_goes_on_with_its_parts(tmp_path):
    measured = []

    def run(parts, stops=True):
        def part(number):
            if stops and number == 2:
                raise KeyboardInterrupt
            measured.append(number)
            return {"loss": float(number)}

        rows = [parts(f"part {number}", partial(part, number)) for number in range(4)]
        return {"ours": {"loss": sum(row["loss"] for row in rows)}}

    with pytest.raises(KeyboardInterrupt):
        Group("some", run).figures(tmp_path)
    assert Group("some", partial(run, stops=False)).figures(tmp_path) == {"ours": {"loss": 6.0}}
    assert measured == [0, 1, 2, 3]  # each once
    assert [path.suffix for path in tmp_path.iterdir()] == [".json"]  # parts go once the whole is kept


def test_where_one_row_s_weights_change_the_other_parts_stay(tmp_path):
    """A row with weights of its own is measured again; the parts of the others are known."""
    measured, weights = [], tmp_path / "weights"

    def run(parts):
        def part(name):
            measured.append(name)
            return float(len(measured))

        return {name: {"loss": parts(name, partial(part, name))} for name in ("ours", f"rival {weights.read_bytes()}")}

    for content in (b"one", b"two", b"two"):
        weights.write_bytes(content)
        Group("some", run, {"quick": True}, {"rival": weights}).figures(tmp_path / "work")
    assert measured == ["ours", "rival b'one'", "rival b'two'"]


def test_without_data_every_row_says_what_it_lacks(tmp_path):
    for paper, tables in PAPERS.items():
        found = measure_tables(TablesConfig(paper, work=tmp_path))
        assert [table["number"] for table in found] == [table.number for table in tables]
        for table in found:
            assert all(row["not_run"] for row in table["rows"])
    assert any("--data" in row["not_run"] for row in measure_tables(TablesConfig())[0]["rows"])


def test_the_command_prints_json_in_a_folder_where_nothing_was_measured(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    EvaluateTables(paper="mmdmc", table=3, json=True).run()
    (table,) = json.loads(capsys.readouterr().out)["tables"]
    assert table["rows"][2]["cells"]["PMD_a"]["paper"] == 1.91
    assert table["rows"][2]["cells"]["PMD_a"]["paper_over_reference"] == pytest.approx(1.91 / 5.42)


def test_every_number_of_the_page_is_in_the_commands_json():
    docs = Path(__file__).parents[3] / "docs"
    told = json.loads((docs / "tables.json").read_text())
    known = {f"{value:{form}}" for value in _numbers(told["tables"]) for form in (".3g", ".2g", "g")}
    rows = [line for line in (docs / "tables.md").read_text().splitlines() if line.startswith("|")]
    cells = {part.strip() for line in rows for cell in line.split("|")[2:-1] for part in re.split("[/±() ]", cell)}
    shown = {cell for cell in cells if re.fullmatch(r"-?[\d.]+(e[+-]?\d+)?", cell)}
    assert len(shown) > 50 and shown <= known


def _numbers(value):
    if isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _numbers(each)
    elif isinstance(value, int | float):
        yield value


def test_samples_do_not_see_where_a_body_stands_and_faces():
    body = reference_body("toddler")
    still = body_samples(body.vertices[None], body)
    turned = body.vertices @ matrix_y(np.array([2.1]))[0].T + [3, 0, -1]
    np.testing.assert_allclose(body_samples(turned[None], body), still, atol=1e-4)
    lifted = (body_samples(turned[None] + [0, 0.1, 0], body) - still).reshape(-1, 3)
    height = float(np.ptp(body.vertices[:, 1]))
    assert lifted[:, 1] == pytest.approx(0.1 / height, abs=1e-4) and np.abs(lifted[:, [0, 2]]).max() < 1e-4
