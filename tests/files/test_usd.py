"""USD files, read and skinned by USD itself."""

import resource
import sys

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, made_up_handles, made_up_motion, textured_glb

from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.errors import FormatError, MissingExtraError
from bunraku.files import load_character
from bunraku.files.usd import prim_name
from bunraku_lab.synthetic.samples import make_sample

Y_FROM_Z = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # rows times this


@pytest.fixture
def pxr():
    return pytest.importorskip("pxr", reason="needs the extra 'usd'")


@pytest.fixture(scope="module")
def animation():
    body = reference_body()
    return Animation(body.character(), body.handles, made_up_motion(body.character(), frames=9))


def baked(path):
    """Frames a second, the points of the mesh in each frame in our frame and metres, and the stage."""
    from pxr import Gf, Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(path))
    end = int(stage.GetEndTimeCode())
    root = UsdSkel.Root(stage.GetDefaultPrim())
    if root:
        assert UsdSkel.BakeSkinning(root, Gf.Interval(0, end))
    meshes = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert len(meshes) == 1
    points = np.array(
        [meshes[0].GetPointsAttr().Get(frame) for frame in range(end + 1)], float
    ) * UsdGeom.GetStageMetersPerUnit(stage)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
        points = points @ Y_FROM_Z
    return stage, meshes[0], points


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "usdz"])
@pytest.mark.parametrize("points", [False, True])
def test_skinned_by_usd(pxr, animation, tmp_path, suffix, points):
    path = animation.save(tmp_path / f"dance.{suffix}", points=points)
    stage, mesh, posed = baked(path)
    assert np.abs(posed - animation.vertices()).max() < 1e-4 * animation.character.height
    assert stage.GetTimeCodesPerSecond() == 20 and stage.GetRootLayer().framesPerSecond == 20
    assert np.array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), animation.character.faces)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]  # nothing is left beside it


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usdz"])
def test_a_full_disk_leaves_the_old_file(pxr, animation, tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # modules imported meanwhile would be cut off, for good
    path = animation.save(tmp_path / f"dance.{suffix}")
    old, limits = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200, limits[1]))
    try:
        with pytest.raises(FormatError, match="free some space"):
            animation.save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == old and [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("points", [False, True])
def test_the_stage_says_its_axis_and_unit(pxr, animation, tmp_path, points):
    from pxr import UsdGeom

    stage, mesh, posed = baked(animation.save(tmp_path / "dance.usdc", up="+z", unit="cm", points=points, fps=40))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == pytest.approx(0.01)
    assert len(posed) == 17 and np.abs(posed[::2] - animation.vertices()).max() < 1e-4 * animation.character.height
    raw = np.array(mesh.GetPointsAttr().Get(0))
    assert np.ptp(raw, axis=0).max() > 100  # centimetres
    stage, _, _ = baked(animation.save(tmp_path / "plain.usdc"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1


def test_colours_and_awkward_names(pxr, tmp_path):
    cube = Character("2. Würfel / böse", CUBE, CUBE_FACES, colors=np.full((8, 3), 188))
    animation = Animation(cube, made_up_handles(cube), made_up_motion(cube, frames=3))
    _, mesh, posed = baked(animation.save(tmp_path / "würfel 1.usda"))
    assert np.allclose(np.array(mesh.GetDisplayColorAttr().Get()), 0.5029, atol=1e-3)  # USD's colours are linear
    assert np.abs(posed - animation.vertices()).max() < 1e-4


def test_points_that_move_on_their_own(pxr, animation, tmp_path):
    offsets = 0.1 * np.sin(np.arange(9))[:, None, None] * animation.character.vertices
    moved = PointAnimation(animation, offsets)
    _, _, posed = baked(moved.save(tmp_path / "dance.usdc"))
    assert np.abs(posed - animation.vertices() - offsets).max() < 1e-5


@pytest.fixture
def textured(tmp_path):
    """A file of three meshes with a skin, a texture and two materials."""
    (tmp_path / "in.glb").write_bytes(textured_glb())
    character = load_character(tmp_path / "in.glb")
    (tmp_path / "in.glb").unlink()
    return Animation(character, made_up_handles(character), made_up_motion(character, frames=3))


@pytest.mark.parametrize("suffix", ["usda", "usdz"])
@pytest.mark.parametrize("points", [False, True])
def test_pieces_have_their_materials(pxr, textured, tmp_path, suffix, points):
    from pxr import Gf, Usd, UsdGeom, UsdShade, UsdSkel

    path = textured.save(tmp_path / f"dance.{suffix}", points=points)
    stage = Usd.Stage.Open(str(path))
    if not points:
        assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetDefaultPrim()), Gf.Interval(0, 2))
    meshes = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert len(meshes) == 3
    corners = np.concatenate(
        [np.array(mesh.GetPointsAttr().Get(2))[np.array(mesh.GetFaceVertexIndicesAttr().Get())] for mesh in meshes]
    )
    want = textured.vertices([2])[0][textured.character.faces.reshape(-1)]
    assert np.abs(corners - want).max() < 1e-4 * textured.character.height
    found = {}
    for mesh in meshes:
        surface = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0].ComputeSurfaceSource()[0]
        source = surface.GetInput("diffuseColor").GetConnectedSource()
        if source:
            asset = UsdShade.Shader(source[0].GetPrim()).GetInput("file").Get()
            found[mesh.GetPrim().GetName()] = asset.path
            assert asset.resolvedPath
            uv = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get())
            assert np.allclose(
                uv[:, 1], 1 - np.random.default_rng(0).random((8, 2)).astype(np.float32)[:, 1], atol=1e-6
            )
        else:
            assert np.allclose(surface.GetInput("diffuseColor").Get(), [0.5, 0.2, 0.1])
    assert len(found) == 1 and next(iter(found)).startswith("body")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == (
        ["dance.usdz"] if suffix == "usdz" else ["dance.usda", "dance_textures"]
    )


@pytest.mark.parametrize("points", [False, True])
def test_usds_own_validators_find_nothing(pxr, textured, tmp_path, points):
    validation = pytest.importorskip("pxr.UsdValidation", reason="this usd-core has no validators")
    from pxr import Usd

    for suffix in ("usda", "usdz"):
        stage = Usd.Stage.Open(str(textured.save(tmp_path / f"dance.{suffix}", points=points)))
        context = validation.ValidationContext(validation.ValidationRegistry().GetOrLoadAllValidators())
        assert [error.GetMessage() for error in context.Validate(stage)] == []


def test_a_folder_in_the_way_of_the_textures(pxr, textured, tmp_path):
    for _ in range(2):  # textures of an earlier file are replaced
        textured.save(tmp_path / "dance.usdc")
    assert [entry.name for entry in (tmp_path / "dance_textures").iterdir()] == ["image_0.png"]
    (tmp_path / "dance_textures" / "thesis.txt").write_text("precious")
    with pytest.raises(FormatError, match="holds other files"):
        textured.save(tmp_path / "dance.usdc")
    assert (tmp_path / "dance_textures" / "thesis.txt").exists()


def test_without_usd(animation, tmp_path, monkeypatch):
    from bunraku.files import check_writer

    monkeypatch.setitem(sys.modules, "pxr", None)
    for name in ("Gf", "Sdf", "Usd"):
        monkeypatch.setitem(sys.modules, f"pxr.{name}", None)
    with pytest.raises(MissingExtraError, match=r"bunraku\[usd\]"):
        animation.save(tmp_path / "dance.usd")
    with pytest.raises(MissingExtraError, match=r"bunraku\[usd\]"):
        check_writer(tmp_path / "dance.usdz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("up", ["+y", "+z"])
def test_the_bones_of_a_rig_keep_their_tree_and_names(pxr, tmp_path, up):
    from pxr import UsdSkel

    robot = make_sample("robot", rigged=True)
    rig, random = robot.rig, np.random.default_rng(2)
    turns = matrix_from_axis_angle(0.4 * random.normal(size=(6, len(rig.names), 3)))
    moved = RigAnimation(robot, turns, 0.02 * random.normal(size=(6, len(rig.names), 3)))
    path = moved.save(tmp_path / "robot.usda", up=up)
    stage, _, posed = baked(path)
    skeleton = next(prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton))
    joints = list(UsdSkel.Skeleton(skeleton).GetJointsAttr().Get())
    assert sorted(joint.rpartition("/")[2] for joint in joints) == sorted(map(prim_name, rig.names))
    for joint in joints:
        bone = [prim_name(name) for name in rig.names].index(joint.rpartition("/")[2])
        above = joint.split("/")[-2] if "/" in joint else None
        parent = int(rig.parents[bone])
        assert above == (prim_name(rig.names[parent]) if parent >= 0 else None)
    assert np.abs(posed - moved.vertices()).max() < 1e-4 * robot.height
