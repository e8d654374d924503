"""Broken files for all readers: a seed number is a file, so that what a long run finds can be made again.

python tests/fuzz/fuzz.py --count 100000           many files, the last line says what was found
python tests/fuzz/fuzz.py --count 5000 --projects  projects of the studio, unpacked into a folder that is then read anew
python tests/fuzz/fuzz.py --first 4711 --count 1   the file of one seed, kept with --keep FOLDER
"""

from __future__ import annotations

import argparse
import base64
import gzip
import io
import json
import logging
import random
import signal
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "files"))

from gltf_files import CUBE, CUBE_FACES, Maker, cube_glb, textured_glb  # noqa: E402
from mmd_bytes import plank, pmd, pmx  # noqa: E402
from motion_files import humanml3d_vectors, walk_about  # noqa: E402

from bunraku.errors import BunrakuError  # noqa: E402
from bunraku.files import load_character  # noqa: E402
from bunraku.pipelines.to_reference import load_motion  # noqa: E402
from bunraku.studio.projects import unpack_project  # noqa: E402
from bunraku.studio.state import SAMPLE  # noqa: E402
from bunraku.studio.store import Store  # noqa: E402

SECONDS, PER_BYTE, BASE = 10.0, 4, 300e6
FAULTS = ("foreign", "slow", "large", "outside")
STRANGE = (
    -1, 0, 1, 255, 65536, 2**31, 2**40, 10**30, -0.5, 1e308, True, None, "", "x", "../secret.bin", "/etc/hostname",
    "file:///etc/hostname", "C:\\secret.bin", [], {}, [[]], [0] * 50, {"count": 5},
)  # fmt: skip
INSIDES = tuple(
    str(Path(at).resolve()) for at in (sys.prefix, sys.base_prefix, HERE.parents[1], sys.pycache_prefix or HERE)
)

_opened: list[str] = []
_watching = False


def _watch(event: str, words: tuple[object, ...]) -> None:
    if _watching and event == "open" and isinstance(words[0], str | bytes | Path):
        _opened.append(str(words[0]))


def seeds() -> list[tuple[str, bytes]]:
    """Good files of every kind that is read, small and made here, but for one FBX of the tests."""
    maker = Maker()
    position, corners = maker.add(CUBE), maker.add(CUBE_FACES.reshape(-1).astype(np.uint16))
    mesh = {"primitives": [{"attributes": {"POSITION": position}, "indices": corners}]}
    tree = maker.tree(nodes=[{"mesh": 0}], meshes=[mesh])
    tree["buffers"][0]["uri"] = "data:;base64," + base64.b64encode(maker.binary).decode()
    vrm = json.loads(json.dumps(tree))
    vrm["nodes"] += [{"children": [2], "translation": [0, 1, 0]}, {"translation": [0, 1, 0]}]
    vrm |= {"scenes": [{"nodes": [0, 1]}], "skins": [{"joints": [1, 2]}]}
    vrm["extensions"] = {
        "VRMC_vrm": {"humanoid": {"humanBones": {"hips": {"node": 1}}}},
        "VRMC_springBone": {
            "springs": [{"joints": [{"node": 1}, {"node": 2}]}],
            "colliders": [{"node": 1, "shape": {}}],
        },
    }
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in CUBE_FACES]
    header = "ply\nformat {} 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 12\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [f"{x} {y} {z}" for x, y, z in CUBE] + [f"3 {a} {b} {c}" for a, b, c in CUBE_FACES]
    faces = b"".join(b"\x03" + np.array(face, "<i4").tobytes() for face in CUBE_FACES)
    stl = bytes(80) + (12).to_bytes(4, "little")
    for face in CUBE_FACES:
        stl += bytes(12) + CUBE[face].astype("<f4").tobytes() + bytes(2)
    walk = walk_about(20)
    positions = walk.world()[1]
    vectors = io.BytesIO()
    np.save(vectors, humanml3d_vectors(positions)[0])
    joints = io.BytesIO()
    np.save(joints, positions.astype(np.float32))
    amass = io.BytesIO()
    np.savez(amass, poses=np.zeros((10, 156)), trans=np.zeros((10, 3)), mocap_framerate=30.0, betas=np.zeros(16))
    fbx = gzip.decompress((HERE.parent / "files" / "data" / "boxman_y_up_m.fbx.gz").read_bytes())
    return [
        ("cube.glb", cube_glb()),
        ("textured.glb", textured_glb()),
        ("cube.gltf", json.dumps(tree).encode()),
        ("avatar.vrm", json.dumps(vrm).encode()),
        ("cube.obj", "\n".join(lines).encode()),
        ("text.ply", (header.format("ascii") + "\n".join(rows) + "\n").encode()),
        ("binary.ply", header.format("binary_little_endian").encode() + CUBE.astype("<f4").tobytes() + faces),
        ("cube.stl", stl),
        ("plank.pmx", pmx(plank())),
        ("plank.pmd", pmd(plank())),
        ("boxman.fbx", fbx),
        ("vectors.npy", vectors.getvalue()),
        ("joints.npy", joints.getvalue()),
        ("amass.npz", amass.getvalue()),
        ("walk.bvh", BVH),
    ]


def projects() -> list[tuple[str, bytes]]:
    """The studio's sample project with short files, twice, since a project is broken by what it says and as a ZIP."""
    said, out = json.loads(zipfile.ZipFile(SAMPLE).read("project.json")), io.BytesIO()
    with zipfile.ZipFile(SAMPLE) as sample, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as project:
        for name in sample.namelist():
            project.writestr(name, sample.read(name)[: 10_000 if name == "project.json" else 300])
    return [(f"{said['character']['name']}.bunraku", out.getvalue())]


def open_project(path: Path) -> None:
    """Unpack a project into a studio's folder, which is then read as after a restart."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        store = Store(Path(folder))
        try:
            unpack_project(store, path)
        finally:
            Store(Path(folder))


BVH = b"""HIERARCHY
ROOT Hips
{
 OFFSET 0 90 0
 CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
 JOINT Spine
 {
  OFFSET 0 20 0
  CHANNELS 3 Zrotation Xrotation Yrotation
  End Site
  {
   OFFSET 0 20 0
  }
 }
}
MOTION
Frames: 3
Frame Time: 0.0333
0 90 0 0 0 0 0 0 0
0 90 1 5 0 0 0 9 0
0 90 2 9 0 0 0 0 9
"""


def broken(seed: int, corpus: list[tuple[str, bytes]]) -> tuple[str, bytes]:
    """The name and the bytes of a seed's file."""
    rng = random.Random(seed)
    name, data = rng.choice(corpus)
    for _ in range(rng.choice((1, 1, 2, 4))):
        data = rng.choice((_flipped, _cut, _spliced, _json_changed, _json_changed, _numbered))(rng, data, corpus)
    return name, data or b"\0"


def _flipped(rng: random.Random, data: bytes, corpus: object) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 3, 30))):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _cut(rng: random.Random, data: bytes, corpus: object) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _spliced(rng: random.Random, data: bytes, corpus: list[tuple[str, bytes]]) -> bytes:
    other = rng.choice(corpus)[1]
    start, length = rng.randrange(len(other) + 1), rng.choice((4, 64, 4096))
    at = rng.randrange(len(data) + 1)
    return data[:at] + other[start : start + length] + data[at + rng.choice((0, length)) :]


def _numbered(rng: random.Random, data: bytes, corpus: object) -> bytes:
    """Four bytes that are a number which counts or measures often are not."""
    value = rng.choice((0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x00FFFFFF, 0x7FC00000, 0x7F800000))
    at = rng.randrange(max(len(data) - 4, 0) + 1)
    return data[:at] + value.to_bytes(4, "little") + data[at + 4 :]


def _json_changed(rng: random.Random, data: bytes, corpus: object) -> bytes:
    """One value of the JSON of a glTF or GLB changed; other files as in `_numbered`."""
    if data[:4] == b"PK\x03\x04" and b"project.json" in data:
        return _project_changed(rng, data)
    glb = data[:4] == b"glTF" and len(data) > 20
    length = int.from_bytes(data[12:16], "little") if glb else len(data)
    try:
        tree = json.loads(data[20 : 20 + length] if glb else data)
    except (ValueError, RecursionError):
        return _numbered(rng, data, corpus)
    positions = []
    stack = [tree]
    while stack:
        owner = stack.pop()
        keys = list(owner) if isinstance(owner, dict) else range(len(owner)) if isinstance(owner, list) else ()
        for key in keys:
            positions.append((owner, key))
            stack.append(owner[key])
    if not positions:
        return data
    owner, key = rng.choice(positions)
    value = owner[key]
    choice = rng.randrange(5)
    if choice == 0 and type(value) in (int, float):
        owner[key] = value + rng.choice((-1, 1, 1000, 2**20))
    elif choice == 1 and isinstance(value, list) and value:
        owner[key] = value * rng.choice((2, 300))
    elif choice == 2:
        other, name = rng.choice(positions)
        owner[key] = json.loads(json.dumps(other[name]))
    else:
        owner[key] = rng.choice(STRANGE)
    text = json.dumps(tree).encode()
    if not glb:
        return text
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    sizes = [(2).to_bytes(4, "little"), *(n.to_bytes(4, "little") for n in (20 + len(text) + len(rest), len(text)))]
    return b"".join([b"glTF", *sizes, b"JSON", text, rest])


def _project_changed(rng: random.Random, data: bytes) -> bytes:
    """What a project says changed at one place, or one of its files missing, twice there, or under another name."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            files = [(name, archive.read(name)) for name in archive.namelist()]
    except Exception:  # broken before
        return _numbered(rng, data, None)
    number, choice = rng.randrange(len(files)), rng.randrange(8)
    name, inside = files[number]
    if choice == 0:
        del files[number]
    elif choice == 1:
        files.append((name, inside))
    elif choice == 2:
        files[number] = rng.choice(("../out.bin", "/tmp/out.bin", f"character/../../{name}", "a" * 300, "./")), inside
    else:
        files = [(at, _json_changed(rng, text, None) if at == "project.json" else text) for at, text in files]
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, text in files:
            archive.writestr(each, text)
    return out.getvalue()


class TooSlow(BaseException):
    """Raised by the timer."""


def check(path: Path) -> set[str]:
    """Read a file; which faults there were: none, or some of `FAULTS`."""
    global _watching
    faults: set[str] = set()
    read = load_motion if path.suffix in (".bvh", ".npy", ".npz") else load_character
    read = open_project if path.suffix == ".bunraku" else read
    size = path.stat().st_size
    before, resting = time.process_time(), _peak(reset=True)
    _opened.clear()

    def stop(number: int, frame: object) -> None:
        raise TooSlow

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    _watching = True
    try:
        read(path)
    except BunrakuError:
        pass
    except TooSlow:
        faults.add("slow")
    except Exception as error:
        faults.add("foreign")
        print(f"{path.name}: {type(error).__name__}: {error}", file=sys.stderr)
    finally:
        _watching = False
        signal.setitimer(signal.ITIMER_PROF, 0)
    if time.process_time() - before > SECONDS:
        faults.add("slow")
    if _peak() - resting > PER_BYTE * size + BASE:
        faults.add("large")
    for name in _opened:
        if path.suffix == ".bunraku" and "/" not in name:
            continue  # in an open folder, as shutil.rmtree names what it removes
        opened = str(Path(name).resolve())
        if not opened.startswith((str(path.parent.resolve()), "/proc", "/dev", "/sys", *INSIDES)):
            faults.add("outside")
            print(f"{path.name}: opened {name}", file=sys.stderr)
    return faults


def _peak(reset: bool = False) -> int:
    """Largest memory since the last reset [bytes], 0 where the system does not tell."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) << 10
    except (OSError, IndexError, ValueError):
        return 0


def run(
    first: int, count: int, keep: Path | None = None, corpus: list[tuple[str, bytes]] | None = None
) -> Counter[str]:
    """Read the files of so many seeds; how often there was each fault, by name, and "files"."""
    if not getattr(run, "hooked", False):
        sys.addaudithook(_watch)
        run.hooked = True  # type: ignore[attr-defined]
    logging.disable(logging.WARNING)
    warnings.simplefilter("ignore")  # names that are twice in a ZIP
    corpus = corpus or seeds()
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as scratch, np.errstate(all="ignore"):
        folder = Path(scratch) / "files"
        folder.mkdir()
        (Path(scratch) / "secret.bin").write_bytes(bytes(1000))
        for name, data in corpus:  # so that what is imported on the way is imported before anything is measured
            (folder / name).write_bytes(data)
            check(folder / name)
        for seed in range(first, first + count):
            name, data = broken(seed, corpus)
            path = folder / f"{seed}-{name}"
            path.write_bytes(data)
            faults = check(path)
            found.update(faults)
            found["files"] += 1
            if faults or keep:
                if keep:
                    keep.mkdir(exist_ok=True, parents=True)
                    (keep / path.name).write_bytes(data)
                if faults:
                    print(f"seed {seed} ({name}): {', '.join(sorted(faults))}", file=sys.stderr)
            path.unlink()
    logging.disable(logging.NOTSET)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--keep", type=Path, help="folder for the files")
    parser.add_argument("--projects", action="store_true", help="projects of the studio in place of files")
    args = parser.parse_args()
    found = run(args.first, args.count, args.keep, projects() if args.projects else seeds())
    print(
        f"{found['files']:,} files: {found['foreign']} foreign exceptions, {found['slow']} over {SECONDS:.0f} s of "
        f"processor time, {found['large']} over {PER_BYTE} x the file + 300 MB, {found['outside']} paths outside"
    )
    return 1 if any(found[fault] for fault in FAULTS) else 0


if __name__ == "__main__":
    sys.exit(main())
