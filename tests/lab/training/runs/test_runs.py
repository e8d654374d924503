from dataclasses import asdict, dataclass
from pathlib import Path

from bunraku_lab.training.runs.runs import append_row, plain_settings


@dataclass
class Settings:
    out: Path = Path("runs/x")
    sizes: tuple[int, ...] = (1, 2)
    nested: dict[str, Path] | None = None


def test_settings_become_what_json_can_say():
    assert plain_settings(asdict(Settings(nested={"a": Path("b")}))) == {
        "out": "runs/x",
        "sizes": [1, 2],
        "nested": {"a": "b"},
    }


def test_rows_go_below_one_head_line(tmp_path):
    log = tmp_path / "log.csv"
    append_row(log, {"step": 1, "loss": 0.123456789, "extra": 3}, ("step", "loss", "later"))
    append_row(log, {"step": 2, "later": 5}, ("step", "loss", "later"))
    assert log.read_text().splitlines() == ["step,loss,later", "1,0.123457,", "2,,5"]


def test_a_log_that_was_only_begun_gets_its_head_line(tmp_path):
    (tmp_path / "log.csv").touch()
    append_row(tmp_path / "log.csv", {"step": 1})
    assert (tmp_path / "log.csv").read_text().split() == ["step", "1"]
