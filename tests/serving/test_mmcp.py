"""`bunraku serve --mmcp`, asked by the SDK's own client."""

import os
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip("motionmcp", reason="the SDK is not installed: pip install 'bunraku[mmcp]'")

from motionmcp import client

from bunraku.body.reference import reference_body


@pytest.fixture(scope="module")
def address():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "bunraku", "serve", "--mmcp", "--port", str(port)], env=dict(os.environ)
    )
    where = f"http://127.0.0.1:{port}"
    end = time.monotonic() + 120
    while client.probe_server(where).status != "online":
        assert server.poll() is None and time.monotonic() < end
        time.sleep(0.2)
    yield where
    server.terminate()
    server.wait(20)


def asked(address, segments, **more):
    (model,) = client.get_capabilities(address)["models"]
    return client.generate(address, {
        "protocol_version": "1.4", "model": model["id"], "skeleton": model["canonical_skeleton"],
        "segments": segments, **more,
    })  # fmt: skip


def test_a_sentence_from_the_client_to_a_moving_skeleton(address):
    (model,) = client.get_capabilities(address)["models"]
    names = [joint["name"] for joint in model["canonical_skeleton"]["joints"]]
    assert names == list(reference_body().skeleton.names) and model["fps"] == 20
    walk = {"type": "text", "prompt": "walks forward", "duration_frames": 60}
    document = asked(address, [walk], timing={"fps": 30}, options={"seed": 1, "num_samples": 2})
    assert document["asset"]["version"] == "2.0" and len(document["nodes"]) >= len(names)
    one, two = client.parse_gltf_samples(document)
    root = one["local_translations"][:, 0]
    assert root.shape == (60, 3) and np.linalg.norm(root[-1, [0, 2]] - root[0, [0, 2]]) > 0.8  # two seconds of a walk
    assert np.abs(root - two["local_translations"][:, 0]).max() > 1e-3
    assert np.ptp(one["local_rot_mats"], axis=0).max() > 0.3
    again = client.parse_gltf_samples(asked(address, [walk], timing={"fps": 30}, options={"seed": 1}))[0]
    np.testing.assert_allclose(again["local_translations"][:, 0], root, atol=1e-3)


def test_segments_follow_each_other_along_a_path(address):
    segments = [{"type": "text", "prompt": text, "duration_frames": 40} for text in ("walks", "waves")]
    path = {"type": "root_path", "frames": [0, 40, 79], "positions_xz": [[0, 0], [0, 1], [0, 1.2]]}
    (sample,) = client.parse_gltf_samples(asked(address, segments, constraints=[path], options={"seed": 2}))
    root = sample["local_translations"][:, 0][:, [0, 2]]
    assert len(root) == 80 and np.abs(root[40] - [0, 1]).max() < 0.2 and np.abs(root[:, 0]).max() < 0.2


def test_what_cannot_be_is_said_in_the_protocols_words(address):
    with pytest.raises(client.MmcpError) as refused:
        asked(address, [{"type": "text", "prompt": "frobnicates the zorp", "duration_frames": 40}])
    assert refused.value.code == "invalid_request" and "movement" in str(refused.value)
    with pytest.raises(client.MmcpError) as refused:
        asked(
            address,
            [{"type": "text", "prompt": "walks", "duration_frames": 40}],
            constraints=[{"type": "effector_target", "joint": "head", "frames": [3], "positions": [[0, 1, 0]]}],
        )
    assert refused.value.code == "unsupported_constraint"
