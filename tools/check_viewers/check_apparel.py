"""Bones of hair and clothes in other programs: VRM's springs in three-vrm against our own simulation, a minute long,
and PMX's rigid bodies and joints in mmd-parser.

    python tools/check_viewers/check_apparel.py --modules NODE_MODULES [--seeds 810019 ...] [--seconds 60]

NODE_MODULES needs three, @pixiv/three-vrm and mmd-parser. Characters are those of the wardrobe as bare meshes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from bunraku import Character, save_character, transfer
from bunraku.anatomy.anatomy import Anatomy
from bunraku.apparel.chains.avatars import mmd_avatar, vrm_avatar
from bunraku.apparel.chains.chain_rig import Chained
from bunraku.apparel.chains.moving import steady_simulation
from bunraku.core.animation import RigAnimation
from bunraku.core.geometry.rotations import quaternion_from_matrix
from bunraku.pipelines.animate import rig
from bunraku.pipelines.clothes import rig_with_chains
from bunraku_lab.synthetic.stock_motions import stock_motion
from bunraku_lab.synthetic.wardrobe import wardrobe_character

HERE = Path(__file__).parent
MMD = np.array([1.0, 1, -1]) / 0.08
MOTIONS = ("walk", "dance")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--modules", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[810_019, 810_003, 810_038])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--own-mask", action="store_true", help="take the mask of the network, not the true one")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [_character(seed, asked, Path(folder)) for seed in asked.seeds]
    for row in rows:
        print(json.dumps(row))
    shares = [value for row in rows for value in row["vrm"].values()]
    print(f"VRM over rigid: mean {np.mean(shares):.3f}, worst {max(shares):.3f}; "
          f"PMX alike: {all(row['pmx'] for row in rows)}")  # fmt: skip


def _character(seed: int, asked: argparse.Namespace, folder: Path) -> dict[str, object]:
    from bunraku.apparel.mask import apparel_mask

    model = wardrobe_character(seed)
    mask = None if asked.own_mask else apparel_mask(model)
    bare = Character(str(seed), model.vertices, model.faces)
    made = rig_with_chains(Anatomy.of(bare, rig(bare)), "vrm", mask)
    avatar, models = folder / f"{seed}.vrm", folder / f"{seed}.pmx"
    save_character(made.character, avatar, rig=True, avatar=vrm_avatar(made))
    save_character(made.character, models, rig=True, avatar=mmd_avatar(made))
    vrm = {kind: _swung(made, avatar, kind, asked, folder) for kind in MOTIONS}
    return {"seed": seed, "chains": len(made.chains), "vrm": vrm, "pmx": _same(made, models, asked.modules)}


def _swung(made: Chained, avatar: Path, kind: str, asked: argparse.Namespace, folder: Path) -> float:
    """How far three-vrm's bones are from ours, over how far those are that go with the body."""
    own = transfer(made.character, stock_motion(kind, asked.seconds, 30.0), onto="rig")
    assert isinstance(own, RigAnimation) and made.character.rig is not None
    moved = own.at(30.0)
    ours = steady_simulation(moved, made.rig()).animation.world()[1]
    still = moved.world()[1]
    names = made.character.rig.names
    links = {int(bone) for chain in made.chains for bone in chain.bones} | set(made.ends)
    bones = [bone for bone in range(len(names)) if bone not in links]
    watched = sorted(links)
    turns = quaternion_from_matrix(moved.rotations[:, bones].astype(np.float64)).astype("<f4")
    root = (made.character.rig.positions[bones[0]] + moved.translations[:, bones[0]]).astype("<f4")
    files = {key: str(folder / f"{kind}.{key}") for key in ("turns", "root", "out")}
    Path(files["turns"]).write_bytes(np.ascontiguousarray(turns).tobytes())
    Path(files["root"]).write_bytes(np.ascontiguousarray(root).tobytes())
    job = {"vrm": str(avatar), "bones": [names[bone] for bone in bones], "frames": len(moved), "fps": 30.0,
           "watch": [names[bone] for bone in watched], **files}  # fmt: skip
    subprocess.run(["node", str(HERE / "three_vrm.mjs"), str(asked.modules)], input=json.dumps([job]), text=True,
                   check=True)  # fmt: skip
    found = json.loads(Path(files["out"] + ".json").read_text())
    theirs = np.frombuffer(Path(files["out"]).read_bytes(), "<f4").reshape(len(moved), len(watched), 3)
    assert np.isfinite(theirs).all() and found["springs"] == sum(len(chain) for chain in made.chains)
    rest = np.linalg.norm(made.character.rig.positions[watched][:, None] - made.character.rig.positions[0], axis=-1)
    reach = np.linalg.norm(theirs - still[:, :1], axis=-1)
    assert reach.max() < 4 * rest.max() + 1, "a spring explodes"
    apart = np.linalg.norm(theirs - ours[:, watched], axis=-1).mean()
    return round(float(apart / np.linalg.norm(still[:, watched] - ours[:, watched], axis=-1).mean()), 3)


def _same(made: Chained, path: Path, modules: Path) -> bool:
    """Whether another reader finds the same bones, bodies and joints in a PMX."""
    done = subprocess.run(["node", str(HERE / "mmd_parse.mjs"), str(modules), str(path)], check=True,
                          capture_output=True, text=True)  # fmt: skip
    found = json.loads(done.stdout)[0]
    rig, own = made.character.rig, mmd_avatar(made)
    assert rig is not None
    good = [bone["name"] for bone in found["bones"]] == list(rig.names)
    good &= [bone["parent"] for bone in found["bones"]] == rig.parents.tolist()
    good &= bool(np.allclose([bone["position"] for bone in found["bones"]], rig.positions * MMD, atol=1e-4))
    good &= [(body["name"], body["bone"], body["type"]) for body in found["bodies"]] == [
        (body.name, body.bone, body.mode) for body in own.bodies
    ]
    places = [body.position * MMD for body in own.bodies]
    good &= bool(np.allclose([body["position"] for body in found["bodies"]], places, atol=1e-4))
    good &= [tuple(joint["bodies"]) for joint in found["joints"]] == [tuple(joint.bodies) for joint in own.joints]
    places = [joint.position * MMD for joint in own.joints]
    return good & bool(np.allclose([joint["position"] for joint in found["joints"]], places, atol=1e-4))


if __name__ == "__main__":
    main()
