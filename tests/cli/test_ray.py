"""`--jobs ray` on a real cluster of two nodes on this machine, one of which goes away in the middle."""

from __future__ import annotations

import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from bunraku.cli.transfer.jobs import Pair
from bunraku.cli.transfer.runs import run_pairs

ray = pytest.importorskip("ray", reason="ray is not installed; pip install 'bunraku[ray]'")
PAIRS = 40


def slow_batch(settings: object, batch: list[Pair]) -> list[str]:
    """In the place of transfers: a moment's work that notes who did it."""
    for pair in batch:
        time.sleep(0.5)
        with open(pair.output, "ab") as file:
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


def test_a_node_that_goes_away_loses_nothing(cluster, tmp_path, monkeypatch):
    """The transfers are stood in for, so that this is about the cluster; the transfers themselves have their tests."""
    found, second = cluster
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])  # its workers do not know the tests' folder
    monkeypatch.setattr("bunraku.cli.transfer.runs._run_batch", slow_batch)
    pairs = [Pair(Path("c.glb"), Path("m.bvh"), tmp_path / f"{number}.out") for number in range(PAIRS)]
    said: Counter[Path] = Counter()
    for done, (pair, reason) in enumerate(run_pairs(pairs, None, "ray")):
        assert reason == ""
        said[pair.output] += 1
        if done == 8:
            assert len(ray.nodes()) == 2
            found.remove_node(second, allow_graceful=False)
    assert said == Counter({pair.output: 1 for pair in pairs})
    assert all(pair.output.stat().st_size >= 1 for pair in pairs)
