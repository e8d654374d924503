"""The studio's routes by a client of their own, httpx, and the document that describes them."""

import re
import time

import httpx2 as httpx
import pytest

from bunraku.io.play import load_animation
from bunraku.samples import sample_character


@pytest.fixture
def client(studio):
    base, _, token = studio.address.partition("/#token=")
    with httpx.Client(base_url=f"{base}/api", headers={"authorization": f"Bearer {token}"}, timeout=60) as one:
        yield one


def test_a_sentence_from_a_client_to_a_moving_character(client, tmp_path):
    from bunraku import save_character

    mesh = save_character(sample_character("mushroom"), tmp_path / "mushroom.glb")
    made = client.post("/characters", params={"name": "mushroom.glb"}, content=mesh.read_bytes()).json()
    asked = {"script": [{"text": "waves", "seconds": 1}], "seeds": [1], "steps": 4, "candidates": 1, "draft": False}
    ended(client, made["job"])
    begun = client.post(f"/characters/{made['character']['id']}/takes", json=asked).json()
    ended(client, begun["job"])
    file = client.post(f"/takes/{begun['takes'][0]}/exports", json={"format": "fbx", "fps": 30}).json()
    ended(client, file["job"])
    (tmp_path / "wave.fbx").write_bytes(client.get(f"/exports/{file['export']}").content)
    assert load_animation(tmp_path / "wave.fbx", 0, 30).vertices().std(axis=0).max() > 0


def ended(client, job):
    end = time.monotonic() + 300
    while (found := client.get(f"/jobs/{job}").json())["state"] in ("waiting", "running"):
        assert time.monotonic() < end
        time.sleep(0.2)
    assert found["state"] == "done", found


def test_the_document_names_every_route_and_what_it_reads(client, studio):
    document = client.get("/openapi.json").json()
    assert document["openapi"] == "3.1.0" and "/openapi.json" in document["paths"]
    from bunraku.studio.routes import characters, files, general, library, takes

    rooms = (characters, files, general, library, takes)
    known = {(path, method.lower()) for room in rooms for path, methods, _ in room.ROUTES for method in methods}
    told = {(path, method) for path, entry in document["paths"].items() for method in entry}
    assert known <= told and len(told) == len(known) + 1
    assert all(entry["summary"] for path in document["paths"].values() for entry in path.values())
    body = document["paths"]["/characters/{name}/takes"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    assert {"script", "seeds", "loop"} <= set(body["properties"])
    assert not re.search(r"object at 0x", str(document))
    assert httpx.get(str(client.base_url) + "openapi.json").status_code in (401, 403)
