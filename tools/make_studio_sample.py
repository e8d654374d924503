"""Write the project that a new studio shows: a sample character that walks and waves.

    python tools/make_studio_sample.py

It goes through the studio's own tasks, so it is what the studio would make.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from bunraku.files import sample_character, save_character
from bunraku.studio.projects import pack_project
from bunraku.studio.state import SAMPLE
from bunraku.studio.store import Store
from bunraku.studio.tasks import run_task
from bunraku.studio.workspace import Workspace

NAME = "dragon"
SCRIPT = [{"text": "walks forward", "seconds": 4}]
SEED = 1


def main() -> None:
    """Make and write it."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        workspace = Workspace(folder)
        settings = {"up": "auto", "front": "auto", "unit": "auto", "handles": "predict"}
        file = f"source/{NAME}.glb"
        fresh = {
            "name": NAME, "file": file, "settings": settings, "sample": NAME,
            "state": "opening", "error": "", "version": 1,
        }  # fmt: skip
        character = store.new("characters", fresh)
        source = store.folder_of("characters", character["id"]) / file
        source.parent.mkdir()
        save_character(sample_character(NAME), source)

        def quiet(stage: str, done: float) -> None:
            """Nobody waits for it."""

        told = run_task(
            workspace,
            "open",
            {"character": character["id"], "file": file, "settings": settings},
            quiet,
            lambda said: None,
        )
        store.change("characters", character["id"], **told, state="ready")
        take = store.new("takes", {
            "character": character["id"], "state": "waiting", "star": False, "error": "", "how": "animate",
            "script": SCRIPT, "seed": SEED, "seeds": [SEED],
            "asked": {"seeds": [SEED], "steps": 20, "guidance": 3, "loop": False, "in_place": False},
        })  # fmt: skip
        said: dict = {}
        run_task(
            workspace, "animate",
            {
                "character": character["id"], "takes": [take["id"]], "seeds": [SEED], "seconds": 4.0,
                "script": f"{SCRIPT[0]['text']}:4", "draft": False, "loop": False, "in_place": False,
                "apparel": "rigid", "steps": 20, "guidance": 3.0, "candidates": 3,
            },
            quiet,
            said.update,
        )  # fmt: skip
        said.pop("take")
        store.change("takes", take["id"], **said)
        pack_project(store, character["id"], {"take": take["id"], "script": SCRIPT, "seed": SEED}, SAMPLE)
    print(f"{SAMPLE}: {SAMPLE.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
