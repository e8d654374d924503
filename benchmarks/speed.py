"""Time each part of `bunraku animate`, each against its plain reference in the same run.

    python benchmarks/speed.py [--threads 2] [--sizes 2000 20000 200000] [-o outputs/speed.json]

| part | reference |
| --- | --- |
| load | trimesh, which keeps no skin, weights or animation |
| handles: network mesh, network, weights on every vertex | the same with the graph layers written one vertex at a time
|
| one sampling step with guidance | two passes, one with and one without the sentence, conditions encoded anew each time
|
| skinning, all frames of 6 s | one handle and one frame at a time in double precision (timed on some frames, scaled up)
|
| export | pygltflib, one accessor a call, base64-free |

Skinning is also set against the matrix product alone, and against a large square product. Best of several runs, in
seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

FRAMES = 120


def best(call: Callable[[], object], runs: int = 5, budget: float = 6.0) -> float:
    """Seconds of the fastest of up to `runs` calls within a time budget."""
    times: list[float] = []
    while len(times) < runs and (not times or sum(times) < budget):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--sizes", type=int, nargs="+", default=[2000, 20000, 200000])
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    for package in ("pygltflib", "trimesh"):  # only compared with, so no set-up of ours brings the first
        if find_spec(package) is None:
            parser.error(f"this compares with {package}; install it with: pip install {package}")
    for variable in (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
    ):  # read when the libraries load, so before any import of them
        os.environ[variable] = str(args.threads)

    import numpy as np

    results: dict[str, object] = {"threads": args.threads, "frames": FRAMES}
    square = np.random.default_rng(0).normal(size=(2048, 2048)).astype(np.float32)
    results["gemm_peak_gflops"] = peak = 2 * 2048**3 / best(lambda: square @ square, 8) / 1e9
    step, step_reference = sampling_step()
    results["sampling_step"] = {"bunraku": step, "reference": step_reference}
    print(f"{args.threads} threads, GEMM peak {peak:.0f} GFLOP/s")
    print(f"one sampling step, {FRAMES} frames: {step * 1e3:.1f} ms, reference {step_reference * 1e3:.1f} ms")
    print(
        f"{'vertices':>9} {'load':>16} {'handles':>16} {'skinning':>18} {'export':>16} {'animate 6 s':>12}   "
        "skin/gemm skin/peak"
    )
    rows = []
    for size in args.sizes:
        row = time_size(size)
        row["skin_over_peak"] = row["skin_gflops"] / peak
        rows.append(row)
        cell = lambda part, row=row: f"{row[part]:.4f}/{row[part + '_reference']:.3f}"  # noqa: E731
        print(
            f"{row['vertices']:>9} {cell('load'):>16} {cell('handles'):>16} {cell('skin'):>18} {cell('export'):>16} "
            f"{row['animate']:>12.2f}"
            f"   {row['skin_over_gemm']:.2f}      {row['skin_over_peak']:.2f}",
            flush=True,
        )
    results["sizes"] = rows
    if args.output:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text(json.dumps(results, indent=1))


def sampling_step() -> tuple[float, float]:
    """Seconds of one guided prediction of x0, ours and the reference's."""
    import numpy as np

    from bunraku.core.nn.layers import Condition, one_thread
    from bunraku.generation.networks import Networks
    from bunraku.generation.sampler import row_noise

    model, encoder = Networks().denoiser, Networks().encoder
    text = encoder.encode(["a person walks forward"])
    x = row_noise(FRAMES, model.config.features, 0)[None]

    def run(rows: list[bool], condition: Condition | None = None) -> Condition:
        count = len(rows)
        if condition is None:
            parts = (part.repeat(count, axis=0) for part in (text.tokens, text.mask, text.pooled))
            condition = model.condition(*parts, None, np.array(rows), np.zeros(count, bool))
        model(x.repeat(count, axis=0), 500, np.full(count, FRAMES), condition, False)
        return condition

    with one_thread():
        kept = run([True, False])
        ours = best(lambda: run([True, False], kept), 20)
        reference = best(lambda: (run([True]), run([False])), 20)
    return ours, reference


def character_of(size: int, folder: Path) -> Path:
    """A GLB of a person with about so many vertices."""
    import numpy as np
    import trimesh

    from bunraku.core.body.reference import reference_body
    from bunraku.core.character import Character
    from bunraku.files import save_character

    body = reference_body()
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    if size < len(mesh.vertices):
        import fast_simplification

        vertices, faces = fast_simplification.simplify(
            body.vertices, body.faces.astype(np.int32), target_count=2 * size
        )
        mesh = trimesh.Trimesh(vertices, faces, process=False)
    while len(mesh.vertices) < size:
        need = (size - len(mesh.vertices)) / len(mesh.edges_unique)
        faces = None if need > 0.9 else np.arange(max(1, int(len(mesh.faces) * need)))
        mesh = mesh.subdivide(face_index=faces)
    path = folder / f"person-{size}.glb"
    save_character(Character(f"person-{size}", mesh.vertices, mesh.faces), path)
    return path


def time_size(size: int) -> dict[str, float]:
    """All parts at one size."""
    import numpy as np
    import trimesh

    import bunraku
    from bunraku.anatomy.handles.predict import _model, predict_handles
    from bunraku.core.animation import Animation
    from bunraku.core.geometry.simplify import network_mesh
    from bunraku.core.nn.checkpoints import shipped_checkpoint
    from bunraku.core.skinning import skin, skin_basis
    from bunraku_lab.nn.graph import EdgeConv, edge_conv_reference, mesh_graph

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        path = character_of(size, folder)
        row: dict[str, float] = {"load": best(lambda: bunraku.load_character(path))}
        row["load_reference"] = best(lambda: trimesh.load(path, process=False))
        character = bunraku.load_character(path)
        row["vertices"] = len(character.vertices)

        row["handles"] = best(lambda: predict_handles(character))
        weights_path = shipped_checkpoint("handles")
        network = _model(weights_path.resolve(), weights_path.stat().st_mtime_ns)
        mesh = network_mesh(character.vertices, character.faces, network.config.mesh_vertices)
        slow = 0.0
        import torch

        graph = mesh_graph(mesh.vertices, mesh.normals, mesh.edges, mesh.areas, network.config.anchors)
        for widths in pairwise((6, *network.config.levels)):
            layer, x = EdgeConv(*widths), torch.zeros(len(mesh.vertices), widths[0])
            with torch.inference_mode():
                fast = best(lambda layer=layer, x=x: layer(x, graph))
                slow += best(lambda layer=layer, x=x: edge_conv_reference(layer, x, graph), 1) - fast
        row["handles_reference"] = row["handles"] + slow

        handles = bunraku.rig(character)
        animation = bunraku.animate(character, "a person walks forward", seconds=FRAMES / 20, handles=handles)
        transforms = animation.motion.transforms(handles.positions)
        row["skin"] = best(lambda: skin(character.vertices, handles.weights, transforms), 9)
        left = np.ascontiguousarray(transforms.transpose(0, 2, 1, 3)).reshape(3 * FRAMES, -1)
        right = skin_basis(character.vertices, handles.weights)
        product = best(lambda: left @ right, 9)
        row["skin_gflops"] = 2 * left.shape[0] * left.shape[1] * right.shape[1] / row["skin"] / 1e9
        row["skin_over_gemm"] = product / row["skin"]

        row["export"] = best(lambda: animation.save(folder / "out.glb"))
        row["export_reference"] = best(lambda: export_reference(animation, folder / "reference.glb"))

        def whole() -> Animation:
            loaded = bunraku.load_character(path)
            result = bunraku.animate(loaded, "a person walks forward", seconds=FRAMES / 20)
            result.save(folder / "whole.glb")
            return result

        row["animate"] = best(whole, 3)
    return row


def export_reference(animation: object, path: Path) -> None:
    """The same content through pygltflib, written plainly."""
    import numpy as np
    import pygltflib as gl

    from bunraku.core.animation import Animation
    from bunraku.core.geometry.rotations import quaternion_from_matrix

    assert isinstance(animation, Animation)
    tree, blob = gl.GLTF2(), bytearray()

    def add(values: np.ndarray, component: int, kind: str) -> int:
        data = np.ascontiguousarray(values).tobytes()
        blob.extend(b"\0" * (-len(blob) % 4))
        tree.bufferViews.append(gl.BufferView(buffer=0, byteOffset=len(blob), byteLength=len(data)))
        blob.extend(data)
        low, high = (values.min(0).tolist(), values.max(0).tolist()) if kind == "VEC3" else (None, None)
        tree.accessors.append(
            gl.Accessor(
                bufferView=len(tree.bufferViews) - 1,
                componentType=component,
                count=len(values),
                type=kind,
                min=low,
                max=high,
            )
        )
        return len(tree.accessors) - 1

    character, motion, handles = animation.character, animation.motion, animation.handles
    order = np.argsort(-handles.weights, axis=1)[:, :4]
    shares = np.take_along_axis(handles.weights, order, axis=1)
    attributes = gl.Attributes(
        POSITION=add(character.vertices, gl.FLOAT, "VEC3"),
        JOINTS_0=add(order.astype(np.uint8), gl.UNSIGNED_BYTE, "VEC4"),
        WEIGHTS_0=add((shares / shares.sum(1, keepdims=True)).astype(np.float32), gl.FLOAT, "VEC4"),
    )
    indices = add(character.faces.astype(np.uint32).reshape(-1), gl.UNSIGNED_INT, "SCALAR")
    tree.meshes.append(gl.Mesh(primitives=[gl.Primitive(attributes=attributes, indices=indices)]))
    count = len(handles.positions)
    tree.nodes.append(gl.Node(children=list(range(1, count))))
    tree.nodes.extend(gl.Node() for _ in range(count - 1))
    tree.nodes.append(gl.Node(mesh=0, skin=0))
    inverse = np.tile(np.eye(4, dtype=np.float32), (count, 1, 1))
    inverse[:, 3, :3] = -handles.positions
    tree.skins.append(
        gl.Skin(joints=list(range(count)), inverseBindMatrices=add(inverse.reshape(-1, 16), gl.FLOAT, "MAT4"))
    )
    clip = gl.Animation()
    times = add((np.arange(len(motion)) / motion.fps).astype(np.float32), gl.FLOAT, "SCALAR")
    for handle in range(count):
        rotation = motion.rotations[:, handle] if handle else motion.root_rotation
        index = handles.positions[handle] + (
            motion.translations[:, handle] - handles.positions[0] if handle else motion.root_translation
        )
        for what, values, kind in (
            ("translation", index.astype(np.float32), "VEC3"),
            ("rotation", quaternion_from_matrix(rotation).astype(np.float32), "VEC4"),
        ):
            clip.samplers.append(gl.AnimationSampler(input=times, output=add(values, gl.FLOAT, kind)))
            clip.channels.append(
                gl.AnimationChannel(
                    sampler=len(clip.samplers) - 1, target=gl.AnimationChannelTarget(node=handle, path=what)
                )
            )
    tree.animations.append(clip)
    tree.scenes.append(gl.Scene(nodes=[0, count]))
    tree.scene = 0
    tree.buffers.append(gl.Buffer(byteLength=len(blob)))
    tree.set_binary_blob(bytes(blob))
    tree.save_binary(str(path))


if __name__ == "__main__":
    main()
