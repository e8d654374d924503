"""Every door answers: each request of each, with an argument that is valid, empty, wrong or hostile, gets a result or
one sentence in the door's own words. The requests come from the doors themselves, so that a new one cannot be
forgotten.
"""

import asyncio
import dataclasses
import importlib
import inspect
import json
import re
import types
from pathlib import Path
from typing import Annotated, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import bunraku
from bunraku.cli import main
from bunraku.cli.app import VERBS
from bunraku.core.request import Constraint

HOSTILE = ("../../../etc/passwd", "x" * 264, "walks\ud800\0", "<script>", 1e308, float("nan"), -1, [[]] * 3, {"a": {}})
"""Paths that lead out, names that are too long, texts that no file takes, numbers that no clip lasts."""
KINDS = ("valid", "empty", "wrong", "hostile")
FOREIGN = {
    "mcp": r"--\w|force=True|reload the page",
    "http": r"--(?!folder)\w|force=True",
    "python": r"--\w|reload the page",
    "command": r"force=True|reload the page",
    "node": r"--\w|force=True",
}
"""Words of other doors."""


def is_sentence(said, door):
    assert said and "\n" not in said and len(said) < 1500, said
    assert "Traceback" not in said and "fault of Bunraku" not in said, said
    assert not re.search(FOREIGN[door], said), said


def valid_of(hint, name):
    """A value that a parameter takes; files are named and not there, so that no work follows."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return valid_of(inner[0], name)
    if origin in (Union, types.UnionType):
        return valid_of(inner[0], name)
    if origin is Literal:
        return inner[0]
    if origin in (list, tuple) or hint in (list, tuple):
        return []
    if origin is dict or dataclasses.is_dataclass(hint):
        return {}
    values = {str: "no.glb" if name in ("character", "file", "motion") else "walks", bool: True, int: 1, float: 2.0}
    return values.get(hint, "walks")


def arguments(hint, name, first=0):
    """Values of each kind for a parameter; of the hostile ones, parameters get another first."""
    valid = valid_of(hint, name)
    wrong = 5 if isinstance(valid, str | list | dict) else "five"
    return {
        "valid": [valid],
        "empty": ["", None, [], {}],
        "wrong": [wrong, object],
        "hostile": [*HOSTILE[first % 9 :], *HOSTILE[: first % 9]],
    }


def cases(hints, each=None):
    """Pairs of a kind and arguments, one parameter after another other than valid, with so many values of each kind."""
    valid = {name: valid_of(hint, name) for name, hint in hints.items()}
    yield "valid", valid
    yield "empty", {}
    yield "wrong", {**valid, "wheels": 4}
    for name, hint in hints.items():
        for kind, values in arguments(hint, name, len(name)).items():
            for value in values[: 1 if kind == "valid" else each]:
                yield kind, {**valid, name: value}


def forms_of_routes():
    """What the body of a route is read as, by path and method."""
    from bunraku.studio.server.app import API

    return {(path, method): getattr(handler, "form", None) for path, methods, handler in API for method in methods}


def test_hints_that_are_read_at_run_time_resolve():
    from bunraku.pipelines.requests import CONSTRAINTS
    from bunraku.studio.tasks import TASKS

    kinds = [*TASKS.values(), *filter(None, forms_of_routes().values())]
    kinds += [getattr(importlib.import_module(home.split(":")[0]), home.split(":")[1]) for home in CONSTRAINTS.values()]
    for kind in kinds:
        if getattr(kind, "from_json", Constraint.from_json).__func__ is Constraint.from_json.__func__:
            assert get_type_hints(kind) or not dataclasses.fields(kind)


def test_every_tool_of_mcp(tmp_path):
    pytest.importorskip("mcp")
    from mcp.server.mcpserver.exceptions import ToolError

    from bunraku.cli.serving import TOOLS, Tools, mcp_server

    server, count = mcp_server(tmp_path), 0
    for tool in TOOLS:
        hints = get_type_hints(getattr(Tools, tool))
        hints.pop("return")
        for _, given in cases(hints):
            if object in given.values():
                continue  # no JSON
            count += 1
            try:
                asyncio.run(server.call_tool(tool, given))
            except ToolError as error:
                is_sentence(str(error), "mcp")
    print(f"{count} calls of {len(TOOLS)} tools")
    with pytest.raises(ToolError, match="has no 'query'"):
        asyncio.run(server.call_tool("clips", {"query": "walk"}))
    with pytest.raises(ToolError, match="or set `force`"):
        asyncio.run(server.call_tool("animate", {"character": "no.glb", "sentence": "blorg zint"}))
    assert list(tmp_path.iterdir()) == []


def test_every_route(client, ready, monkeypatch):
    monkeypatch.setattr("bunraku.studio.routes.takes.PATIENCE", 0)  # nobody works here

    state, count, forms = client.app.state.studio, 0, forms_of_routes()
    made = state.new_takes(ready, 1, how="animate", script=[{"text": "walks", "seconds": 2}], seeds=[0])[0]["id"]
    state.store.change("takes", made, state="done", skin="handles", frames=40, seconds=2.0)
    query = ["name", "q", "tag", "after", "sample", "apparel", "stiffness", "onto", "skin"]
    for path, methods in client.get("/api/openapi.json").json()["paths"].items():
        for method in methods:
            if path == "/login":
                continue
            form = forms[path, method.upper()]
            bodies = [given for _, given in cases(get_type_hints(form), each=2)] if form else []
            bodies += [b"", b"{", b"[]", b'{"a": "\\ud800"}', b'{"view": 5}', b'{"text": 5}', b"\xff" * 100]
            owner = made if path.startswith("/takes") else ready
            for target in (owner, "0" * 16, "..%2f..", "x" * 264, "%00"):
                for body in bodies if target == owner and method not in ("get", "delete") else bodies[-1:]:
                    try:
                        data = body if isinstance(body, bytes) else json.dumps(body).encode()
                    except TypeError:
                        continue  # no JSON
                    count += 1
                    answer = client.request(method, "/api" + re.sub(r"{\w+}", target, path), content=data)
                    refused(answer)
            for value in ("", "x" * 2000, "../..", "\x00", "nan", "-1"):
                count += 1
                asked = dict.fromkeys(query, value)
                refused(client.request(method, "/api" + re.sub(r"{\w+}", owner, path), params=asked, content=b""))
            state.jobs._waiting.clear()
            for kind, name in (("takes", made), ("characters", ready)):
                if state.store.get(kind, name).get("deleted"):
                    state.change(kind, name, deleted=False)
            state.store.change("characters", ready, state="ready")
    print(f"{count} requests")


def refused(answer):
    """A result, or a sentence."""
    assert answer.status_code < 500 or answer.status_code == 507, (answer.request.url, answer.text)
    if answer.status_code >= 400 and answer.headers["content-type"] == "application/json":
        is_sentence(answer.json()["error"], "http")


@pytest.mark.parametrize("verb", [" ".join(verb) for verb in VERBS if verb != ("studio",)])
def test_every_command(verb, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    values = {"valid": ["no.glb"], "empty": ["", "--output", ""], "wrong": ["--wheels", "4"]}
    values |= {f"hostile {number}": [str(text)] for number, text in enumerate(HOSTILE) if isinstance(text, str)}
    for kind, words in values.items():
        extra = ["walks"] if verb in ("animate", "edit", "transfer") and kind != "wrong" else []
        if verb in ("doctor", "clips", "samples") and kind == "valid":
            words = ["--json"] if verb == "doctor" else ["--list"] if verb == "samples" else ["charleston"]
        try:
            status = main([verb, *words, *extra])
        except SystemExit as left:
            status = left.code
        said = capsys.readouterr().err.strip().splitlines()
        assert status in (0, 1, 2), said
        lines = [line for line in said if line.startswith("bunraku: error: ")]
        assert status == 0 or lines or f"bunraku {verb} --help" in said[-1] + said[-2] or verb == "doctor", (kind, said)
        for line in lines:
            is_sentence(line, "command")
    print(f"{len(values)} calls of {verb}")
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.startswith(("no", "..", "x"))) == []


PYTHON = [name for name in bunraku.__all__ if inspect.isfunction(getattr(bunraku, name))]


@pytest.mark.parametrize("name", PYTHON)
def test_every_function_of_python(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    function = getattr(bunraku, name)
    cube = bunraku.Character("cube", CUBE, FACES)
    given = {"character": cube, "prompt": "walks", "name": "person", "path": tmp_path / "out.glb", "seconds": 0.5,
             "steps": 1, "candidates": 1, "motion": "no.bvh", "clip": "no.glb", "names": "mixamo",
             "preset": "unity", "program": "unity", "clips": {}}  # fmt: skip
    known, count = inspect.signature(function).parameters, 0
    needed = {key: given.get(key, "walks") for key, one in known.items() if one.default is one.empty or key in given}
    if name not in ("transfer", "load_motion"):
        needed.pop("clip", None) if "clip" in known and known["clip"].default is not inspect.Parameter.empty else None
    for given in ({}, {**needed, "wheels": 4}):
        count += 1
        with pytest.raises(bunraku.BunrakuError) as error:
            function(**given)
        is_sentence(str(error.value), "python")
    for key, one in known.items():
        if one.kind is one.VAR_KEYWORD or key == "progress":
            continue
        for value in ("", [], object(), 5, np.float32("nan"), *HOSTILE[:4]):
            if key in ("seconds", "steps", "candidates", "fps", "seed") and value == 5:
                continue  # which is valid, and work
            count += 1
            try:
                function(**{**needed, key: value})
            except bunraku.BunrakuError as error:
                is_sentence(str(error), "python")
    print(f"{count} calls of {name}")
    assert not [path for path in tmp_path.rglob("*") if path.name.startswith("..")]


CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                  [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip


def test_every_node(tmp_path, monkeypatch):
    from importlib.resources import files

    path = Path(str(files("bunraku.studio"))) / "addon" / "comfyui" / "__init__.py"
    spec = importlib.util.spec_from_file_location("nodes", path)
    nodes = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(nodes)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.glb").write_bytes(b"glTF")
    count = 0
    for node in nodes.NODE_CLASS_MAPPINGS.values():
        asked = node.INPUT_TYPES()["required"]
        valid = {name: what[1]["default"] if len(what) > 1 else what[0][0] for name, what in asked.items()}
        valid |= {"model_file": "a.glb", "address": "http://localhost:1/#token=x"}
        for name in asked:
            for value in ("", None, 5, *HOSTILE[:4]):
                count += 1
                with pytest.raises(ValueError) as error:
                    getattr(node(), node.FUNCTION)(**{**valid, name: value})
                is_sentence(str(error.value), "node")
    print(f"{count} calls of {len(nodes.NODE_CLASS_MAPPINGS)} nodes")
