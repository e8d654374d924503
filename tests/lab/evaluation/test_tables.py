"""The papers' tables."""

import json
import math
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_y
from bunraku.errors import OptionError
from bunraku_lab.cli.evaluate_motion import EvaluateTables
from bunraku_lab.evaluation.report import Report
from bunraku_lab.evaluation.tables.measured import PAPERS, TablesConfig, _over_runs, measure_tables
from bunraku_lab.evaluation.tables.paper_table import (
    EITHER_WAY,
    Group,
    PaperRow,
    PaperTable,
    half_interval,
    measured_table,
    shown_table,
)
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


def test_runs_have_intervals_too():
    row = {"fid": {"mean": 2.0, "half": 0.5}, "mm_dist": {"mean": 3.0, "half": 0.1}, "other": {"mean": 1.0, "half": 0}}
    assert _over_runs(row) == {"FID": 2.0, f"FID {EITHER_WAY}": 0.5, "MM-Dist": 3.0, f"MM-Dist {EITHER_WAY}": 0.1}


def test_intervals_are_those_of_a_mean():
    values = [1.0, 2.0, 3.0, 6.0]
    assert half_interval(values) == pytest.approx(1.96 * math.sqrt(14 / 3) / 2) and half_interval([3.0]) == 0
    found = measured_table(TABLE, {"ours": {"loss": 1.5, f"loss {EITHER_WAY}": 0.25}})
    assert "| ours | 0.2 / 1.5 ± 0.25 | 0.25 / - |" in Report(shown_table(found)).markdown()


def test_a_row_stands_in_for_a_reference_that_is_not_measured():
    table = replace(TABLE, stand_in="other")
    found = measured_table(table, {"ours": {"loss": 1.0}, "other": {"loss": 4.0}})
    assert found["rows"][1]["cells"]["loss"]["ours_over_reference"] == 0.25
    assert "(ratios to base, ours to other)" in Report(shown_table(found)).markdown()
    found = measured_table(table, {"ours": {"loss": 1.0}, "other": {"loss": 4.0}, "base": {"loss": 2.0}})
    assert found["rows"][1]["cells"]["loss"]["ours_over_reference"] == 0.5


def test_without_data_every_row_says_what_it_lacks(tmp_path):
    for paper, tables in PAPERS.items():
        found = measure_tables(TablesConfig(paper, work=tmp_path))
        assert [table["number"] for table in found] == [table.number for table in tables]
        for table in found:
            assert all(row["not_run"] for row in table["rows"])
    assert any("--data" in row["not_run"] for row in measure_tables(TablesConfig())[0]["rows"])


def test_a_table_that_is_not_there_is_refused():
    with pytest.raises(OptionError, match="table 7"):
        measure_tables(TablesConfig("mmdmc", 7))


def test_the_papers_rows_are_as_long_as_their_columns_and_name_their_reference():
    for table in (table for tables in PAPERS.values() for table in tables):
        assert table.reference in [row.name for row in table.rows]
        assert {len(row.paper) for row in table.rows if row.paper is not None} <= {len(table.columns)}


def test_the_command_prints_json(tmp_path, capsys):
    EvaluateTables(paper="mmdmc", table=3, work=tmp_path, json=True).run()
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


def test_samples_of_a_body_at_rest_are_its_handles():
    body = reference_body("tall")
    found = body_samples(body.vertices[None], body).reshape(-1, 3)
    own = body.handle_weights[:, body.handle_weights.sum(axis=0) > 0]
    wanted = own.T @ body.vertices / own.sum(axis=0)[:, None]
    wanted -= wanted[0] * [1, 0, 1]
    gap = np.linalg.norm(found - wanted / np.ptp(body.vertices[:, 1]), axis=1)
    assert gap.max() < 0.01  # the hips of a body are not quite in one line with the sides
