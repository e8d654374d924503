"""`bunraku serve`, called by the SDK's own client over standard input and output."""

import base64
import io
import json
import os
import sys

import pytest

anyio = pytest.importorskip("anyio")
mcp = pytest.importorskip("mcp")

from mcp import Client, StdioServerParameters  # noqa: E402
from PIL import Image  # noqa: E402

from bunraku.files import load_character, save_character  # noqa: E402
from bunraku.files.clips import load_animation  # noqa: E402
from bunraku.files.samples import sample_character  # noqa: E402


def called(folder, *calls):
    """The answers of a server over a folder to calls, by a client that starts it."""

    async def run():
        given = StdioServerParameters(
            command=sys.executable, args=["-m", "bunraku", "serve", str(folder)], env=dict(os.environ)
        )
        async with Client(given) as client:
            tools = {one.name: one for one in (await client.list_tools()).tools}
            return tools, [await client.call_tool(name, values) for name, values in calls]

    return anyio.run(run)


def facts_of(answer):
    assert not answer.is_error, answer.content
    return json.loads(answer.content[0].text)


def picture_of(answer):
    shown = next(part for part in answer.content if part.type == "image")
    assert shown.mime_type == "image/png"
    return Image.open(io.BytesIO(base64.b64decode(shown.data)))


def test_a_sentence_from_a_client_to_a_moving_character(tmp_path):
    folder = tmp_path / "served"
    folder.mkdir()
    (tmp_path / "secret.glb").write_bytes(b"glTF")
    save_character(sample_character("mushroom"), folder / "mushroom.glb")
    sampling = {"seconds": 1.0, "seed": 1, "steps": 4, "candidates": 1}
    tools, answers = called(
        folder,
        ("files", {}),
        ("inspect", {"file": "mushroom.glb"}),
        ("clips", {"text": "walk"}),
        ("animate", {"character": "mushroom.glb", "sentence": "waves", "output": "wave.fbx", "sampling": sampling,
                     "constraints": [{"kind": "in_place"}]}),
        ("animate", {"character": "mushroom.glb", "sentence": "waves", "output": "wave.fbx", "sampling": sampling}),
        ("animate", {"character": "../secret.glb", "sentence": "waves"}),
        ("animate", {"character": "mushroom.glb", "sentence": "waves", "output": "../out.glb"}),
        ("animate", {"character": "mushroom.glb", "sentence": "waves", "apparel": {"motion": "/etc/passwd"}}),
        ("animate", {"character": "mushroom.glb", "sentence": "waves", "sampling": {"seconds": 9e9}}),
        ("render", {"file": "wave.fbx", "output": "wave.gif"}),
        ("transfer", {"character": "mushroom.glb", "motion": "clip:walk-slowly", "output": "walk.glb"}),
        ("transfer", {"character": "mushroom.glb", "motion": "wave.fbx", "apparel": {"motion": "/etc/passwd"}}),
        ("rig", {"character": "mushroom.glb"}),
    )  # fmt: skip
    assert set(tools) == {"files", "animate", "transfer", "rig", "inspect", "render", "clips"}
    assert "sentence" in tools["animate"].input_schema["required"]
    files, inspected, clips, made, again, outside, out, mask, long, drawn, walked, masked, rigged = answers
    assert facts_of(files)["files"] == ["mushroom.glb"]
    assert facts_of(inspected)["vertices"] == len(load_character(folder / "mushroom.glb").vertices)
    assert picture_of(inspected).width > 100
    assert any("walk" in one["name"] for one in facts_of(clips)["clips"])
    assert facts_of(made) == {"file": "wave.fbx", "seconds": 1.0, "notes": []}
    assert picture_of(made).width > 100
    assert len(load_animation(folder / "wave.fbx", 0, 30.0).motion) == 29  # 20 frames at 20 a second
    for refused, says in (
        (again, "there already"), (outside, "in the folder"), (out, "in the folder"), (mask, "apparel is one of"),
        (long, "seconds"), (masked, "apparel is one of"),
    ):  # fmt: skip
        assert refused.is_error and says in refused.content[0].text
    assert facts_of(drawn)["file"] == "wave.gif" and picture_of(drawn).width > 100
    assert facts_of(walked)["file"] == "walk.glb" and picture_of(walked).width > 100
    assert facts_of(rigged)["file"] == "mushroom-rigged.glb" and picture_of(rigged).width > 100
    assert sorted(path.name for path in tmp_path.iterdir()) == ["secret.glb", "served"]
    assert sorted(path.name for path in folder.iterdir()) == [
        "mushroom-rigged.glb",
        "mushroom.glb",
        "walk.glb",
        "wave.fbx",
        "wave.gif",
    ]
