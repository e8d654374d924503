"""The tool for graphics cards: what it packs, trains and joins again."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bunraku.errors import FormatError, OptionError
from bunraku_lab.nn.denoiser import load_denoiser

SPEC = importlib.util.spec_from_file_location("gpu", Path(__file__).parents[3] / "tools" / "gpu.py")
gpu = sys.modules["gpu"] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(gpu)
join_pieces, split_file = gpu.join_pieces, gpu.split_file


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "weights.bin"
    path.write_bytes(np.random.default_rng(0).bytes(40_000))
    return path


def test_what_was_split_is_joined(file, tmp_path):
    folder, out = tmp_path / "back", tmp_path / "run"
    pieces = split_file(file, folder, 16_384)
    assert [piece.name for piece in pieces] == [f"weights.bin.{number}.piece" for number in range(3)]
    assert all(piece.stat().st_size <= 16_384 for piece in pieces)
    assert join_pieces(folder, out) == [out / "weights.bin"]
    assert (out / "weights.bin").read_bytes() == file.read_bytes()
    file.write_bytes(b"short")
    assert len(split_file(file, folder, 16_384)) == 1  # those of before are gone
    join_pieces(folder, out)
    assert (out / "weights.bin").read_bytes() == b"short"


def test_pieces_that_do_not_belong_together_are_named(file, tmp_path):
    folder, out = tmp_path / "back", tmp_path / "run"
    first, second, third = split_file(file, folder, 16_384)
    sound = {piece: piece.read_bytes() for piece in (first, second, third)}

    def head(of, **changes):
        line, _, rest = sound[of].partition(b"\n")
        return json.dumps(json.loads(line) | changes).encode() + b"\n" + rest

    middle = bytearray(sound[second])
    middle[9_000] ^= 1
    for damage, words in (
        ({second: None}, "piece 1 of weights.bin is missing"),
        ({third: None}, "piece 2"),
        ({second: bytes(middle)}, "not what was split"),
        ({third: sound[third][:-5]}, "do not add up"),
        ({second: sound[first]}, "piece 1"),
        ({second: head(second, sha256="0" * 64)}, "different files"),
        ({second: head(second, file="../weights.bin")}, "no piece"),
        ({second: head(second, piece=-1)}, "no piece"),
        ({second: head(second, bytes=None)}, "no piece"),
        ({second: b"\x00" * 5_000}, "no piece"),
        ({piece: head(piece, pieces=10**12) for piece in sound}, "piece 3"),
        ({first: None, second: None, third: None}, "there is no piece"),
    ):
        for piece, data in {**sound, **damage}.items():
            piece.unlink(missing_ok=True)
            if data is not None:
                piece.write_bytes(data)
        with pytest.raises(FormatError, match=words):
            join_pieces(folder, out)
        assert not (out / "weights.bin").exists()
    with pytest.raises(OptionError, match="1024"):
        split_file(file, folder, 1024)


def test_packed_trained_in_two_calls_and_joined(swings, tmp_path, capsys):
    """A step from the packed code alone, one more where it stopped, and the weights come back in pieces, whole."""
    bank, packed, back = tmp_path / "bank.npz", tmp_path / "gpu", tmp_path / "back"
    np.savez(bank, features=np.random.default_rng(0).normal(size=(3, 448)).astype(np.float32))
    gpu.main(["pack", "--data", str(swings), "--mesh-bank", str(bank), "-o", str(packed)])
    assert "8 clips" in capsys.readouterr().out
    assert not (packed / "src/bunraku/weights/diffusion.safetensors").exists()
    words = ["train", "--preset", "small", "--batch", "2", "--device", "cpu", "--threads", "1", "--piece", "4"]
    words += ["--run", str(packed / "run"), "--out", str(back), "--data", str(packed / gpu.BUNDLE), "--steps"]
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHONPATH", "BUNRAKU"))}
    subprocess.run([sys.executable, str(packed / "gpu.py"), *words, "1"], cwd=tmp_path, env=clean, check=True)
    gpu.main([*words, "2"])
    assert "from step 1" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="are more than 3 files"):
        gpu.bring(gpu.parser().parse_args([*words, "2", "--files", "3"]))
    pieces = sorted(back.glob("*.piece"))
    assert len(pieces) >= 5 and max(piece.stat().st_size for piece in pieces) <= 4 << 20
    gpu.main(["join", str(back), "-o", str(tmp_path / "run")])
    assert "2 steps" in capsys.readouterr().out
    whole = tmp_path / "run" / "diffusion.safetensors"
    assert whole.read_bytes() == (packed / "run" / "diffusion.safetensors").read_bytes()
    assert load_denoiser(whole).knows_meshes and (tmp_path / "run" / "log.csv").read_text().startswith("step,")
