"""`--jobs ray` on a real cluster of two nodes on this machine, one of which goes away in the middle."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import pytest

from bunraku.cli import main
from bunraku.cli.shared import run_results
from bunraku.cli.transfer import Pair
from bunraku.files.clips import load_animation
from bunraku_lab.synthetic.stock_motions import stock_motion

ray = pytest.importorskip("ray", reason="ray is not installed; pip install 'bunraku[ray]'")
PAIRS = 40
CLIPS = int(os.environ.get("BUNRAKU_RAY_CLIPS", "12"))
"""Real clips in the second test; 200 take some minutes."""


def slow_batch(batch: list[Pair]) -> list[str]:
    """In the place of transfers: a moment's work that notes who did it."""
    for pair in batch:
        time.sleep(0.5)
        with open(pair.path, "ab") as file:
            file.write(b"x")
    return [""] * len(batch)


@pytest.fixture
def cluster(monkeypatch):
    from ray.cluster_utils import Cluster

    try:
        found = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
        second = found.add_node(num_cpus=1)
        found.wait_for_nodes()
    except Exception as error:  # Ray's own processes did not answer in time, as on a machine with more work than cores
        pytest.skip(f"no cluster of two nodes starts here: {error}")
    monkeypatch.setenv("RAY_ADDRESS", found.address)
    yield found, second
    ray.shutdown()
    found.shutdown()


def test_a_node_that_goes_away_loses_nothing(cluster, tmp_path):
    """The transfers are stood in for, so that this is about the cluster; the transfers themselves have their tests."""
    found, second = cluster
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])  # its workers do not know the tests' folder
    pairs = [Pair(tmp_path / f"{number}.out", (Path("c.glb"), Path("m.bvh"))) for number in range(PAIRS)]
    said: Counter[Path] = Counter()
    for done, (pair, reason) in enumerate(
        run_results(slow_batch, [pairs[start : start + 4] for start in range(0, PAIRS, 4)], "ray")
    ):
        assert reason == ""
        said[pair.path] += 1
        if done == 8:
            assert len(ray.nodes()) == 2
            found.remove_node(second, allow_graceful=False)
    assert said == Counter({pair.path: 1 for pair in pairs})
    assert all(pair.path.stat().st_size >= 1 for pair in pairs)


def test_real_clips_are_all_there_once_where_a_node_goes_away(cluster, tmp_path):
    found, second = cluster
    main(["samples", "mushroom", "-o", str(tmp_path)])
    motions = tmp_path / "motions"
    motions.mkdir()
    for number in range(CLIPS):
        kind = ("walk", "dance", "kick")[number % 3]
        stock_motion(kind, 0.5 + 0.05 * (number % 7), 20.0).save(motions / f"{kind}-{number:03d}.npz")
    out, gone = tmp_path / "out", threading.Event()

    def take_away() -> None:
        while len(list(out.glob("*.glb"))) < CLIPS // 2 and not gone.wait(0.05):
            pass
        if not gone.is_set():
            found.remove_node(second, allow_graceful=False)
            gone.set()

    watcher = threading.Thread(target=take_away)
    watcher.start()
    try:
        words = ["transfer", str(tmp_path / "mushroom.glb"), "--motions", *map(str, sorted(motions.iterdir()))]
        assert main([*words, "--jobs", "ray", "-o", str(out)]) == 0
        midway = gone.is_set()
    finally:
        gone.set()
        watcher.join()
    assert midway and len([node for node in ray.nodes() if node["Alive"]]) == 1
    clips = sorted(out.glob("*.glb"))
    assert len(clips) == CLIPS and all(len(load_animation(clip).motion) >= 10 for clip in clips)
    rows = [json.loads(line) for line in (out / ".bunraku-ledger.jsonl").read_text().splitlines()]
    assert Counter(name for name, _, state in rows if state is not None) == Counter(clip.name for clip in clips)
    assert not [path for path in out.iterdir() if path.suffix not in (".glb", ".jsonl")]
