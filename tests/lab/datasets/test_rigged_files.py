"""Training characters from folders of GLB, FBX, and OBJ with rig texts."""

import gzip
from pathlib import Path

from bunraku.io import save_character
from bunraku.samples import sample_names
from bunraku_lab.datasets.characters.build import build_characters, rigged_files
from bunraku_lab.datasets.characters.training_character import TrainingCharacter
from bunraku_lab.synthetic.samples import make_sample

DATA = Path(__file__).parents[2] / "formats" / "data"


def put_rignet(folder: Path) -> None:
    """A sample character in the layout of the ModelsResource-RigNet archive."""
    character = make_sample("person", 0.3, rigged=True)
    lines = [
        f"joints {name.replace(' ', '_')} {x} {y} {z}"
        for name, (x, y, z) in zip(character.rig.names, character.rig.positions, strict=True)
    ]
    names = [name.replace(" ", "_") for name in character.rig.names]
    lines += [f"root {name}" for name, parent in zip(names, character.rig.parents, strict=True) if parent < 0]
    lines += [
        f"hier {names[parent]} {name}" for name, parent in zip(names, character.rig.parents, strict=True) if parent >= 0
    ]
    for vertex, row in enumerate(character.rig.dense_weights()):
        lines.append(f"skin {vertex} " + " ".join(f"{names[joint]} {row[joint]:.4f}" for joint in row.nonzero()[0]))
    (folder / "obj").mkdir(parents=True)
    (folder / "rig_info").mkdir()
    corners = [f"v {x} {y} {z}" for x, y, z in character.vertices] + [
        f"f {a + 1} {b + 1} {c + 1}" for a, b, c in character.faces
    ]
    (folder / "obj" / "7.obj").write_text("\n".join(corners))
    (folder / "rig_info" / "7.txt").write_text("\n".join(lines))
    (folder / "obj" / "no_rig.obj").write_text("v 0 0 0\n")


def test_all_kinds_become_training_characters(tmp_path):
    put_rignet(tmp_path / "set")
    fbx = gzip.decompress((DATA / "boxman_z_up_cm.fbx.gz").read_bytes())
    (tmp_path / "mixamo").mkdir()
    (tmp_path / "mixamo" / "man.fbx").write_bytes(fbx)
    save_character(make_sample("mushroom", 0.3), tmp_path / "mixamo" / "man.glb")  # of the same name, and without a rig
    found = [path.relative_to(tmp_path).as_posix() for path in rigged_files(tmp_path)]
    assert found == ["mixamo/man.fbx", "mixamo/man.glb", "set/obj/7.obj"]

    for name in sample_names():  # what is there already is kept, so the samples are not built again here
        (tmp_path / "cache" / "samples").mkdir(parents=True, exist_ok=True)
        (tmp_path / "cache" / "samples" / f"{name}.npz").touch()
    done, failed = build_characters(tmp_path, tmp_path / "cache", 300)
    names = {path.relative_to(tmp_path / "cache").with_suffix("").as_posix() for path in done}
    assert (
        {"mixamo/man", "set/obj/7"} <= names
        and list(failed) == ["mixamo/man.glb"]
        and "no rig" in failed["mixamo/man.glb"]
    )
    man, seven = (TrainingCharacter.load(tmp_path / "cache" / f"{name}.npz") for name in ("mixamo/man", "set/obj/7"))
    assert man.handles[0] == 0 and set(man.handles.tolist()) >= {0, 1, 2, 4, 5, 15, 16, 17, 18, 19}  # by Mixamo's names
    left = man.vertices[man.target[:, 18] > 0.9]
    assert len(left) and 0.9 < man.height <= 1.01 and left[:, 0].min() > 0
    assert seven.handles[0] == 0 and len(seven.vertices) <= 300
